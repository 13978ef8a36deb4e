"""Sensors: where they lie, which way they look, and what area they stand for."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import antumbra as at
from antumbra.city.sensors.sensors import Zone

BOX = np.array([[x, y, z] for x in (0, 2) for y in (0, 3) for z in (0, 1)], float)
QUADS = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
FACES = np.array([tri for a, b, c, d in QUADS for tri in ((a, b, c), (a, c, d))])
AREA = 2 * (2 * 3 + 3 * 1 + 2 * 1)


def box(offset=(0, 0, 0), up="z"):
    return at.Scene.from_arrays(BOX + offset, FACES, up=up)


@pytest.mark.parametrize("offset", [(0, 0, 0), (85000.25, 446900.5, -3.0)])
@pytest.mark.parametrize(
    "make",
    [at.face_sensors, at.vertex_sensors, lambda scene: at.grid_sensors(scene, 0.25)],
    ids=["face", "vertex", "grid"],
)
def test_sensors_look_outwards_and_share_the_area(make, offset):
    sensors = make(box(offset))
    assert np.isclose(sensors.areas.sum(), AREA)
    away = sensors.points - offset - (1.0, 1.5, 0.5)
    assert (np.einsum("ij,ij->i", away, sensors.normals) > 0.4).all()
    assert np.allclose(np.linalg.norm(sensors.normals, axis=1), 1.0)
    assert len(sensors) == {"face": 12, "vertex": 8, "grid": AREA * 16}[sensors.kind]


def test_faces_without_area_have_no_sensor():
    flat = np.concatenate([BOX[FACES], [[[0, 0, 0], [1, 1, 1], [2, 2, 2]]]])
    scene = at.Scene.from_arrays(flat)
    assert len(at.face_sensors(scene)) == 12
    assert 12 not in at.face_sensors(scene).faces
    vertices = at.vertex_sensors(scene)
    assert (vertices.corners[12] == -1).all() and (vertices.corners[:12] >= 0).all()
    assert np.array_equal(vertices.points[vertices.corners[:12]], BOX[FACES])


def test_both_sides_of_a_sheet_keep_a_normal():
    sheet = at.Scene.from_arrays([[0, 0, 0], [1, 0, 0], [0, 1, 0]], [[0, 1, 2], [0, 2, 1]])
    assert np.allclose(np.abs(at.vertex_sensors(sheet).normals), (0, 0, 1))


@given(st.integers(0, 2**32 - 1))
def test_a_point_of_the_grid_on_an_edge_lies_in_one_of_its_faces(seed):
    """Triangles that fill a square, with corners on the grid's points: as many points as the square has cells."""
    rng = np.random.default_rng(seed)
    corners = np.array([[0, 0], [8, 0], [8, 8], [0, 8]], float)
    middle = rng.integers(1, 15, 2) / 2
    soup = np.array([[corners[k], corners[(k + 1) % 4], middle] for k in range(4)])
    scene = at.Scene.from_arrays(np.dstack([soup, np.zeros((4, 3))]), up="z")
    sensors = at.grid_sensors(scene, 1.0)
    full = len(np.unique(np.round(sensors.points, 6), axis=0))
    assert full == len(sensors) and 64 <= full <= 64 + 4  # faces that no point meets have one in their centre


def test_small_faces_have_a_sensor_in_their_centre():
    sensors = at.grid_sensors(box(), 10.0)
    assert len(sensors) == 12 and np.isclose(sensors.areas.sum(), AREA)


@pytest.mark.parametrize("up", ["y", "z"])
def test_a_raster_lies_on_the_highest_surfaces_north_first(up):
    turned = np.array([[0, 0, 0], [1, 0, 0], [0, 0, 1], [1, 0, 1]], float)  # a step in the west, lower in the east
    ground = np.concatenate([turned * (4, 1, -4), turned * (2, 1, -4) + (0, 2, 0)])
    if up == "z":
        ground = ground[:, [0, 2, 1]] * (1, -1, 1)
    scene = at.Scene.from_arrays(ground, [[0, 1, 2], [1, 3, 2], [4, 5, 6], [5, 7, 6]], up=up)
    sensors = at.raster_sensors(scene, 1.0, 0.5)
    raster, axis = sensors.raster, "xyz".index(up)
    assert (raster.columns, raster.rows, raster.west, raster.north) == (4, 4, 0.0, 4.0)
    heights = sensors.points[:, axis].reshape(4, 4)
    assert np.allclose(heights[:, :2], 2.5) and np.allclose(heights[:, 2:], 0.5)
    north = sensors.points[:, 1 if up == "z" else 2].reshape(4, 4)[:, 0] * (1 if up == "z" else -1)
    assert np.allclose(north, [3.5, 2.5, 1.5, 0.5])
    assert set(sensors.faces.reshape(4, 4)[:, :2].ravel()) <= {2, 3}
    level = at.raster_sensors(scene, 2.0, 7.0, follow=False)
    assert len(level) == 4 and (level.points[:, axis] == 7.0).all()


@pytest.mark.parametrize(
    "make, message",
    [
        (lambda: at.grid_sensors(box(), 0.0), "spacing of sensors is 0.0"),
        (lambda: at.grid_sensors(box(), 1e-9), "make it wider"),
        (lambda: at.raster_sensors(box(), 1.0, bounds=((1, 1), (1, 5))), "must have a width"),
        (lambda: at.point_sensors([[0, 0]]), r"shape \(m, 3\)"),
        (lambda: at.point_sensors([[0, 0, 0]], [[0, 0, 0]]), "the normal of sensor 0 is zero"),
        (lambda: at.point_sensors([[0, 0, 0]], areas=[-1.0]), "not negative"),
    ],
)
def test_bad_input_is_named(make, message):
    with pytest.raises(at.InputError, match=message):
        make()


# --- sensors made by hand ---------------------------------------------------------------------------------------------

RASTER = at.Raster(0.0, 2.0, 1.0, 2, 1)
BY_HAND = {"points": [[0.5, 0.5, 1.0], [1.5, 1.5, 1.0]], "kind": "points"}
NAN, INF = float("nan"), float("inf")


@pytest.mark.parametrize(
    "fields, words",
    [
        ({"kind": "raster"}, 'of kind "raster" have no raster; give it, or the kind "points"'),
        ({"kind": "face"}, 'of kind "face" have no faces'),
        ({"kind": "grid"}, 'of kind "grid" have no faces'),
        ({"kind": "vertex", "faces": [0, 1]}, 'of kind "vertex" have no corners'),
        ({"raster": RASTER, "cells": [0, 2]}, "cells of sensors hold 2; they must be from 0 to 1"),
        ({"raster": RASTER, "cells": [-1, 0]}, "cells of sensors hold -1; they must be from 0 to 1"),
        ({"raster": RASTER, "cells": [0.0, 1.0]}, "cells of sensors must be whole numbers"),
        ({"raster": RASTER, "cells": [0]}, r"cells of 2 sensors must be numbers \(2,\)"),
        ({"raster": RASTER._replace(columns=3)}, "2 sensors for 3 cells of the raster; give cells"),
        ({"cells": [0, 1]}, "cells of sensors need a raster"),
        ({"raster": RASTER._replace(west="a"), "cells": [0, 1]}, "west of the raster is 'a'"),
        ({"raster": RASTER._replace(north=NAN), "cells": [0, 1]}, "north of the raster is nan"),
        ({"raster": RASTER._replace(spacing=0), "cells": [0, 1]}, "the spacing of the raster is 0"),
        ({"raster": RASTER._replace(rows=-1), "cells": [0, 1]}, "rows of the raster is -1"),
        ({"raster": RASTER._replace(columns=10**6, rows=10**6), "cells": [0, 1]}, "more than 1e"),
        ({"raster": RASTER._replace(crs=3), "cells": [0, 1]}, "crs of the raster is 3"),
        ({"faces": [0, -2]}, "faces of sensors hold -2; they must be at least -1"),
        ({"zone": [0, 1], "zones": (Zone("a", 2, 0),)}, "zone of sensors hold 1; they must be from 0 to 0"),
        ({"zone": [0, 0]}, "zone of sensors hold 0; they must be left out"),
        ({"kind": "vertex", "corners": [[0, 1, 2]]}, "corners of sensors hold 2; they must be from -1 to 1"),
        ({"kind": "vertex", "corners": 3}, r"corners of sensors must be whole numbers \(faces, 3\), not \(\)"),
        ({"normals": [[0, 0, 1], [0, 0, 0]]}, "the normal of sensor 1 is zero"),
        ({"normals": [[0, 0, 1], [0, NAN, 0]]}, "the normal of sensor 1 has NaN"),
        ({"areas": [1, -1]}, "areas of sensors must be finite and not negative"),
        ({"areas": [1, INF]}, "areas of sensors must be finite and not negative"),
    ],
)
def test_wrong_fields_are_refused_at_construction(fields, words):
    with pytest.raises(at.InputError, match=words) as refused:
        at.Sensors(**{**dict.fromkeys(("normals", "areas", "faces")), **BY_HAND, **fields})
    assert "\n" not in str(refused.value)


def test_right_fields_are_kept():
    made = at.Sensors(BOX, [[0, 0, 5]] * 8, None, None, "points")
    assert (made.normals == (0, 0, 1)).all()
    exact = at.face_sensors(box())
    again = at.Sensors(exact.points, exact.normals, exact.areas, exact.faces, "face")
    assert again.normals is exact.normals and again.faces.dtype == np.int64
    up = np.broadcast_to(np.array([0.0, 0.0, 1.0]), (8, 3))
    assert at.Sensors(BOX, up, None, None, "points").normals.strides[0] == 0  # rasters have one normal for all cells
    some = at.Sensors(BOX[:2], None, None, None, "raster", RASTER, cells=[1, 0])
    assert some.on_raster(np.array([5.0, 6.0])).tolist() == [[6.0, 5.0]]


@pytest.mark.parametrize("sensors", [at.face_sensors(box()), at.vertex_sensors(box())], ids=["faces", "corners"])
def test_sensors_of_another_scene_are_refused_before_the_work(sensors):
    scene, place = at.Scene.from_arrays(BOX, FACES[:5], up="z"), at.Place(52.0, 4.0)
    jobs = {
        "sun": lambda: at.sun_hours(scene, sensors, "2026-06-21", place=place),
        "sky": lambda: at.sky_view(scene, sensors),
        "matrix": lambda: at.visibility_matrix(scene, sensors),
        "targets": lambda: at.visibility_matrix(scene, [[9.0, 9.0, 9.0]], sensors),
        "viewshed": lambda: at.viewshed(scene, sensors, [9.0, 9.0, 9.0]),
        "table": lambda: at.Table(sensors, {}, scene=scene),
    }
    for name, job in jobs.items():
        with pytest.raises(at.InputError, match=r"(on face 11|of 12 faces), and arrays has 5.*make them for"):
            job()
            raise AssertionError(name)
