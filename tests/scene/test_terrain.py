"""Surfaces of rasters of heights: their triangles, one by one, and answers in closed form."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays

import antumbra as at
import gis_files
import oracle
from antumbra.scene import terrain
from antumbra.scene.terrain import GridPoints, HeightGrid, face_of_cells, faces_of_squares
from strength import examples

PLACE = gis_files.PLACE
HEIGHTS = arrays.arrays(
    np.float64, st.tuples(st.integers(2, 6), st.integers(2, 7)), elements=st.sampled_from([0.0, 0.25, 1.0, 7.5, np.nan])
)


def brute_force(heights, place=PLACE):
    """(n, 3, 3): the triangles that the documentation describes, one square at a time."""
    a, _, west, _, e, north = place
    rows, columns = heights.shape
    at_cell = {
        (i, j): (west + (j + 0.5) * a, north + (i + 0.5) * e, heights[i, j])
        for i in range(rows)
        for j in range(columns)
    }
    triangles = []
    for i in range(rows - 1):
        for j in range(columns - 1):
            north_west, south_east = at_cell[i, j], at_cell[i + 1, j + 1]
            for corners in (north_west, at_cell[i + 1, j], south_east), (north_west, south_east, at_cell[i, j + 1]):
                if not np.isnan(corners).any():
                    triangles.append(corners)
    return np.array(triangles).reshape(-1, 3, 3)


def world(scene):
    return scene.triangles().vertices.astype(np.float64) + scene.origin


def as_set(triangles):
    return {tuple(map(tuple, corners)) for corners in np.round(triangles, 9).tolist()}


@given(HEIGHTS, st.sampled_from([(1, 1), (2, 3), (256, 512)]))
def test_the_triangles_are_the_documented_ones(heights, block):
    expected = brute_force(heights)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(terrain, "_HIGH", block[0])
        patch.setattr(terrain, "_WIDE", block[1])
        if not len(expected):
            with pytest.raises(at.InputError, match=r"no cell has a height|no triangles"):
                at.from_raster((heights, PLACE))
            return
        scene = at.from_raster((heights, PLACE))
        triangles = world(scene)
        faces, squares = (of(scene.data.source._surfaces[0]) for of in (face_of_cells, faces_of_squares))
    assert as_set(triangles) == as_set(expected) and len(triangles) == len(expected)
    across = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
    assert (across[:, 2] > 0.0).all()
    assert scene.meshes[0].triangles == len(expected)
    vertices = {corner for corners in as_set(expected) for corner in corners}
    assert (faces >= 0).sum() == len(vertices)
    assert np.bincount(squares[squares >= 0], minlength=len(triangles)).max() == 1
    for (i, j), face in np.ndenumerate(squares):
        south, east = (not np.isnan(heights[i : i + 2, j : j + 2].ravel()[[0, k, 3]]).any() for k in (2, 1))
        assert (face >= 0) == (south or east)
        if face >= 0:
            corner = (PLACE[2] + 2.0 * j + 1.0 + 2.0 * (not south), PLACE[5] - 2.0 * i - 1.0 - 2.0 * south)
            assert corner in {tuple(each[:2]) for each in triangles[face].tolist()}
    for (i, j), face in np.ndenumerate(faces):
        if face >= 0:
            place = (PLACE[2] + 2.0 * j + 1.0, PLACE[5] - 2.0 * i - 1.0, heights[i, j])
            assert place in set(map(tuple, triangles[face].tolist()))


@given(st.integers(1, 9), st.integers(1, 9))
def test_the_last_triangle_at_each_vertex(rows, columns):
    expected = np.full((rows + 1) * (columns + 1), -1)
    for k, corners in enumerate(terrain._squares(rows, columns)):
        expected[corners] = k
    assert terrain._last_faces(rows, columns).reshape(-1).tolist() == expected.tolist()


@examples(20)
@given(HEIGHTS, st.integers(0, 1000))
def test_answers_are_those_of_the_triangles(heights, seed):
    triangles = brute_force(heights)
    if not len(triangles):
        return
    scene, soup = at.from_raster((heights, PLACE)), at.Scene.from_arrays(triangles, up="z")
    soup.origin = scene.origin  # float32 holds the soup, so its own origin may be another
    low, high = scene.bounds
    ends = np.random.default_rng(seed).uniform(low - 1.0, high + 1.0, (2, 40, 3))
    seen = scene.occluded(ends[0], targets=ends[1])
    assert (seen == soup.occluded(ends[0], targets=ends[1])).all()
    local = (ends - scene.origin).astype(np.float32)
    assert (seen == oracle.occluded(soup.triangles().vertices, local[0], ends=local[1])).all()


def test_both_outcomes_occur():
    scene = at.from_raster((gis_files.hills(), PLACE))
    low, high = scene.bounds
    ends = np.random.default_rng(0).uniform(low, high, (2, 200, 3))
    assert 20 < scene.occluded(ends[0], targets=ends[1]).sum() < 180


@given(HEIGHTS, st.integers(0, 1000))
def test_heights_between_cells_are_those_of_rays(heights, seed):
    triangles = brute_force(heights)
    if not len(triangles):
        return
    grid = HeightGrid("a", GridPoints(0.0, 0.0, 1.0, 1.0, *heights.shape), None, heights)
    rows, columns = heights.shape
    u, v = np.random.default_rng(seed).uniform(-0.2, 1.2, (2, 50)) * [[columns - 1], [rows - 1]]
    x, y = PLACE[2] + 2.0 * u + 1.0, PLACE[5] - 2.0 * v - 1.0
    hit = at.from_raster((heights, PLACE)).closest_hit(np.stack([x, y, np.full(50, 100.0)], 1), (0.0, 0.0, -1.0))
    np.testing.assert_allclose(grid.at_cells(u, v), np.where(hit.mask, 100.0 - hit.t, np.nan), atol=1e-5)


def test_on_a_plane_every_point_sees_every_other():
    i, j = np.mgrid[:30, :40]
    scene = at.from_raster((0.5 * j + 0.25 * i, PLACE))
    seen = at.viewshed(scene, "raster+1", scene.bounds.mean(0) + [0.0, 0.0, 1.0]).table["seen"]
    assert (seen == 1).all() and len(seen) == 1200


def test_a_wall_casts_a_shadow_of_its_height():
    heights = np.zeros((5, 60))
    heights[:, 20] = 8.0
    scene = at.from_raster((heights, PLACE))
    cells = at.sensors_of("raster", scene)
    light = at.DirectionalLight((1.0, 0.0, -1.0), angular_diameter=0.0)  # 45 degrees, from the west
    lit = at.visibility(scene, cells.points, light, cells.normals, spp=1).fraction.reshape(5, 60)
    x = 2.0 * (np.arange(60) - 20)
    shaded = (x > 0.0) & (x < 8.0)
    assert shaded.sum() == 3
    edge = np.isclose(x, 8.0)
    assert (lit[:, ~edge] == ~shaded[~edge]).all()


def test_a_pyramid_hides_what_lies_behind_it():
    k = np.abs(np.mgrid[-10:11, -10:11]).max(0)
    scene = at.from_raster((np.maximum(10.0 - 2.0 * k, 0.0), PLACE))
    cells = at.sensors_of("raster", scene)
    eye = scene.bounds.mean(0) * [1, 1, 0] + [-19.9, 0.0, 1.0]
    seen = at.viewshed(scene, cells, eye).table["seen"].reshape(21, 21)
    assert seen[10, :11].all() and not seen[10, 12:].any()
    behind = k > 5
    behind[:, :16] = False
    assert not seen[10, 16:].any() and seen[0].any() and behind.any()


@given(HEIGHTS)
def test_sensors_of_own_cells_lie_where_rays_find_the_surface(heights):
    if not len(brute_force(heights)):
        return
    scene = at.from_raster((heights, PLACE))
    own, traced = at.raster_sensors(scene, None), at.raster_sensors(scene, 2.0, bounds=(
        PLACE[2], PLACE[5] - 2.0 * heights.shape[0], PLACE[2] + 2.0 * heights.shape[1], PLACE[5]))  # fmt: skip
    assert own.raster == traced.raster
    assert (own.covered == traced.covered).all() and ((own.faces >= 0) == (traced.faces >= 0)).all()
    np.testing.assert_allclose(own.points[own.covered], traced.points[own.covered], rtol=0, atol=1e-6)


def test_scenes_without_a_raster_say_so():
    with pytest.raises(at.InputError, match="no raster of its own"):
        at.raster_sensors(at.procedural("atrium", triangles=2000), None)
