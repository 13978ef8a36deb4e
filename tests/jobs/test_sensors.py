"""Sensors: where they lie, which way they look, and what area they stand for."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import antumbra as at

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
