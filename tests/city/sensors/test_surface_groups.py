"""Groups of faces, and the azimuth and tilt of normals."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import antumbra as at
import city_files
from antumbra import examples
from antumbra.city.sensors.surface_groups import (
    azimuths,
    faces_between,
    notes_on_buildings,
    surface_groups,
    tilts,
    unit_normals,
)

FACES = np.array([t for a, b, c, d in city_files.CUBE_FACES for t in ((a, b, c), (a, c, d))])


def box(**more):
    return at.Scene.from_arrays(city_files.CUBE * 1.0, FACES, up="z", **more)


def test_planar_parts_of_a_box_are_its_sides():
    groups = surface_groups(box(name="box"), "surface")
    sides = groups.of_face.reshape(6, 2)
    assert (sides[:, 0] == sides[:, 1]).all() and sorted(sides[:, 0]) == list(range(6))
    assert groups.names == [f"box/{k}" for k in range(6)]
    of_side = [groups.types[k] for k in sides[:, 0]]
    assert of_side == ["GroundSurface", "RoofSurface", *["WallSurface"] * 4]
    facades = surface_groups(box(name="box"), "facade")
    assert (facades.of_face[:4] == -1).all() and facades.names == [f"box/{k}" for k in range(4)]


def test_planar_parts_do_not_reach_across_gaps_or_objects():
    square = np.array([[[0, 0, 0], [1, 0, 0], [1, 1, 0]], [[0, 0, 0], [1, 1, 0], [0, 1, 0]]], float)
    apart = at.Scene.from_arrays(np.concatenate([square, square + (2, 0, 0)]), up="z")
    assert surface_groups(apart, "surface").of_face.tolist() == [0, 0, 1, 1]
    joined = at.Scene.from_arrays(np.concatenate([square, square + (1, 0, 0)]), up="z")
    assert surface_groups(joined, "surface").of_face.tolist() == [0] * 4


def test_a_city_has_surfaces_objects_and_buildings(tmp_path):
    scene = at.load(city_files.put(tmp_path, city_files.everything()))
    objects, buildings = surface_groups(scene, "object"), surface_groups(scene, "building")
    assert objects.names == scene.city.objects == ["tree", "house", "part", "pond"]
    assert buildings.names == ["house"] and buildings.types == ["Building"]
    of_house = np.isin(objects.of_face, (1, 2))
    assert buildings.of_face.tolist() == np.where(of_house, 0, -1).tolist() and 0 < of_house.mean() < 1
    surfaces = surface_groups(scene, "surface")
    assert surfaces.names == [f"{scene.city.objects[each.object]}/{k}" for k, each in enumerate(scene.city.surfaces)]
    assert "RoofSurface" in surfaces.types and surfaces.of_face.tolist() == scene.city.surface_of_face.tolist()


def test_streets_and_trees_are_no_buildings():
    village = examples.village()
    groups = surface_groups(village, "building")
    assert len(groups.names) == 24 and set(groups.types) == {"Building"} and (groups.of_face == -1).any()
    assert notes_on_buildings(village, "building") == []


def test_objects_without_types_count_as_buildings_and_a_note_says_so():
    assert surface_groups(box(name="box"), "building").names == ["box"]
    assert notes_on_buildings(box(name="box"), "building") == [
        "box: its objects have no types, so each counts as a building"
    ]
    assert notes_on_buildings(box(), "object") == notes_on_buildings(box(), np.zeros(12, int)) == []


def test_a_scene_without_buildings_has_no_rows_per_building():
    hills = examples.hills()
    with pytest.raises(at.InputError, match="hills has no buildings, only TINRelief; use surface for the rows"):
        surface_groups(hills, "building")


def test_numbers_form_groups():
    numbers = np.full(12, -1)
    numbers[[3, 5, 8]] = 7, 2, 7
    groups = surface_groups(box(), numbers)
    assert groups.names == ["2", "7"] and groups.of_face[[3, 5, 8, 0]].tolist() == [1, 0, 1, -1]
    with pytest.raises(at.InputError, match=r"groups of faces must be \(12,\) whole numbers"):
        surface_groups(box(), np.zeros(3, int))
    with pytest.raises(at.InputError, match="did you mean 'object'\\? it must be \"face\""):
        surface_groups(box(), "objects")


@pytest.mark.parametrize("up", ["y", "z"])
def test_azimuth_and_tilt(up):
    east, north, height = (
        np.array(values, float) for values in ([0, 1, 0, -1, 0, 0], [1, 0, -1, 0, 0, 0], [0, 0, 0, 0, 1, -1])
    )
    normals = np.stack([east, north, height] if up == "z" else [east, height, -north], 1)
    np.testing.assert_allclose(azimuths(normals, up), [0, 90, 180, 270, np.nan, np.nan])
    np.testing.assert_allclose(azimuths(normals, up, 10.0), [350, 80, 170, 260, np.nan, np.nan])
    np.testing.assert_allclose(tilts(normals, up), [90, 90, 90, 90, 0, 180])


@given(st.floats(0, 360, exclude_max=True), st.floats(-360, 360), st.floats(0, 359))
def test_a_range_of_azimuths_wraps(azimuth, first, width):
    inside = faces_between(np.array([azimuth, np.nan]), first, first + width)
    away = (azimuth - first) % 360.0
    if min(abs(away - width), away, 360.0 - away) > 1e-6:
        assert inside.tolist() == [away <= width, False]


def test_ranges_of_azimuths():
    every = np.array([0.0, 10.0, 180.0, 350.0])
    assert faces_between(every, 350, 10).tolist() == [True, True, False, True]
    assert faces_between(every, 150, 210).tolist() == [False, False, True, False]
    assert faces_between(every, 0, 360).all() and not faces_between(every, 20, 30).any()


def test_normals_of_faces_without_area_are_zero():
    corners = np.array([[[0, 0, 0], [2, 0, 0], [0, 2, 0]], [[0, 0, 0], [1, 1, 1], [2, 2, 2]]], float)
    assert unit_normals(corners).tolist() == [[0, 0, 1], [0, 0, 0]]
