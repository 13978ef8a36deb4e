"""Planar parts: what is joined, what slivers do, and that the order of faces does not matter."""

from itertools import pairwise

import numpy as np
import pytest

import antumbra as at
import city_files
from antumbra.city.sensors.planar_parts import FLAT, IN_PLANE, SLIVER, planar_parts
from antumbra.city.sensors.surface_groups import surface_groups
from scenes import scene_path

CUBE = (city_files.CUBE * 10.0)[[t for a, b, c, d in city_files.CUBE_FACES for t in ((a, b, c), (a, c, d))]].reshape(
    -1, 3, 3
)


def labels_of(corners, objects=None, unit=1.0):
    corners = np.asarray(corners, float)
    return planar_parts(corners, np.zeros(len(corners), int) if objects is None else np.array(objects), unit)[
        0
    ].tolist()


def wall_with_cuts(cuts, height=3.0):
    """Triangles of a wall along x, divided at x; each strip has two."""
    corners = []
    for a, b in pairwise(cuts):
        p, q, r, s = (a, 0, 0), (b, 0, 0), (b, 0, height), (a, 0, height)
        corners += [[p, q, r], [p, r, s]]
    return np.array(corners, float)


def partition(labels, order):
    """Labels of faces in their original order."""
    out = np.empty(len(order), int)
    out[order] = labels
    return out.tolist()


def test_sides_of_a_box_are_parts_in_an_order_of_their_corners():
    labels, first = planar_parts(CUBE, np.zeros(12, int))
    assert (labels[::2] == labels[1::2]).all() and sorted(labels[::2]) == list(range(6))
    assert (labels[first] == np.arange(6)).all()
    least = [np.unique(CUBE[labels == k].reshape(-1, 3), axis=0)[0].tolist() for k in range(6)]
    assert least == sorted(least)


def test_numbers_of_parts_do_not_depend_on_the_order_of_faces_or_their_corners():
    rng = np.random.default_rng(5)
    scene = np.concatenate([CUBE, CUBE + (20, 0, 0), wall_with_cuts([40.0, 41.0, 41.0001, 45.0])])
    objects = np.repeat([0, 1, 0], [12, 12, 6])
    expected = labels_of(scene, objects)
    assert len(set(expected)) == 13
    for _ in range(5):
        order = rng.permutation(len(scene))
        turned = np.stack([np.roll(scene[k], rng.integers(3), 0) for k in order])
        assert partition(labels_of(turned, objects[order]), order) == expected


def test_a_part_belongs_to_one_object_and_ends_at_gaps():
    wall = wall_with_cuts([0.0, 1.0, 2.0])
    assert labels_of(wall) == [0] * 4 and labels_of(wall, [0, 0, 1, 1]) == [0, 0, 1, 1]
    assert labels_of(np.concatenate([wall, wall + (5, 0, 0)])) == [0] * 4 + [1] * 4


@pytest.mark.parametrize("degrees, joined", [(0.9 * FLAT, True), (1.1 * FLAT, False)])
def test_a_bend_divides_walls_from_a_tenth_of_a_degree(degrees, joined):
    wall = wall_with_cuts([0.0, 4.0, 8.0])
    wall[..., 1] += np.maximum(wall[..., 0] - 4.0, 0.0) * np.tan(np.radians(degrees))
    assert (len(set(labels_of(wall))) == 1) == joined


def rounded(corners, step=1e-4):
    """Corners on a coarse lattice in a frame turned by 31 degrees, as files with few decimals have them."""
    c, s = np.cos(np.radians(31.0)), np.sin(np.radians(31.0))
    return np.round(corners @ np.array([[c, s, 0], [-s, c, 0], [0, 0, 1]]) / step) * step


def test_slivers_do_not_divide_a_wall():
    """Rounding turns the normals of strips that are half a millimetre wide by several degrees."""
    wall = rounded(wall_with_cuts([0.0, 2.0, 2.0005, 4.0, 4.0005, 4.001, 7.0]))
    across = np.cross(wall[:, 1] - wall[:, 0], wall[:, 2] - wall[:, 0])
    normals = across / np.linalg.norm(across, axis=1, keepdims=True)
    assert np.degrees(np.arccos((normals @ normals.T).min())) > 10 * FLAT
    assert labels_of(wall) == [0] * len(wall)


def test_slivers_at_a_corner_do_not_join_its_walls():
    one = wall_with_cuts([0.0, 5.0, 5.0 + 0.5 * IN_PLANE])
    other = wall_with_cuts([0.0, 4.0])[..., [1, 0, 2]][:, ::-1] + (5.0 + 0.5 * IN_PLANE, 0, 0)
    labels = labels_of(np.concatenate([one, other]))
    assert labels[:4] == [labels[0]] * 4 and labels[4:] == [labels[4]] * 2 and labels[0] != labels[4]


def test_narrow_faces_of_a_round_tower_stay_apart():
    angles = np.radians(np.arange(0, 361, 5))
    ring = np.stack([np.cos(angles), np.sin(angles), 0 * angles], 1) * 0.4  # facets are 35 mm wide
    corners = []
    for p, q in pairwise(ring):
        corners += [[p, q, q + (0, 0, 3)], [p, q + (0, 0, 3), p + (0, 0, 3)]]
    assert np.linalg.norm(ring[1] - ring[0]) < SLIVER
    labels = labels_of(np.round(corners, 6))
    assert labels[::2] == labels[1::2] and len(set(labels)) == 72


def test_tolerances_are_metres_in_every_unit():
    wall = rounded(wall_with_cuts([0.0, 2.0, 2.0005, 4.0]))
    assert labels_of(wall / 0.3048, unit=1 / 0.3048) == [0] * len(wall)


def test_faces_without_area_join_a_neighbour_and_an_empty_scene_has_no_parts():
    flat = np.array([[[0, 0, 0], [1, 0, 0], [2, 0, 0]]], float)
    assert len(labels_of(np.concatenate([wall_with_cuts([0.0, 2.0]), flat]))) == 3
    assert labels_of(np.empty((0, 3, 3))) == []


def test_facades_of_a_block_of_triangles_in_cityjson(tmp_path):
    """As 3dfier writes them: polygons are triangles, and LoD1 has no semantics."""
    triangles = [[a, b, c] for p, q, r, s in city_files.CUBE_FACES for a, b, c in ((p, q, r), (p, r, s))]
    block = {"type": "MultiSurface", "lod": "1", "boundaries": [[triangle] for triangle in triangles]}
    document = city_files.city({"a": city_files.building(block), "b": city_files.building(block, kind="LandUse")})
    with pytest.warns(UserWarning, match="triangles repeat others"):
        scene = at.load(city_files.put(tmp_path, document))
    assert len(scene.city.surfaces) == 24  # the slivers of the file
    surfaces, facades = surface_groups(scene, "surface"), surface_groups(scene, "facade")
    assert len(surfaces.names) == 12 and len(facades.names) == 4
    assert facades.names == [f"a/{k}" for k in range(4)] and set(facades.types) == {"WallSurface"}
    types = [kind for name, kind in zip(surfaces.names, surfaces.types) if name.startswith("a/")]
    assert sorted(types) == ["GroundSurface", "RoofSurface", *["WallSurface"] * 4]
    assert {kind for name, kind in zip(surfaces.names, surfaces.types) if name.startswith("b/")} == {""}


def test_buildings_of_delft_have_facades():
    scene = at.load(scene_path("delft_city/scene.glb"), up="z")
    facades, faces = surface_groups(scene, "facade"), np.arange(scene.n_triangles)
    names = np.array([each.name for each in scene.objects])[np.asarray(scene.object_of_face[faces])]
    walls = (names == "Building") & (facades.of_face >= 0)
    parts = len(np.unique(facades.of_face[walls]))
    assert walls.sum() > 4000 and parts < walls.sum() / 3
