"""Views over terrain in one sweep: what is certain equals exact lines of sight, and little is left undecided."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from antumbra.city.sight.visibility_matrix import TileTracer
from antumbra.query.receivers import Receivers, receivers_above
from antumbra.trace.terrain.terrain_views import HIDDEN, SEEN, UNDECIDED, decided, ground_of, view_from
from strength import examples
from terrain_scenes import PLACE, rasters, scene_of

TREE = "bsah+wide"
OBLONG = (2.0, 0.0, 84000.0, 0.0, -3.0, 446000.0)
HEIGHTS = rasters(26, 45, [0.0, 0.0, 0.0, 0.25, 1.0, 3.0, 9.0, np.nan])


def cells_of(scene, height):
    """(n, 3): points above the cells, row by row; those without a surface at the lowest height."""
    surface = scene.data.source.surface
    tops, faces = scene.data.cell_tops()
    east, north = np.meshgrid(surface.grid.eastings(), surface.grid.northings())
    return np.c_[east.ravel(), north.ravel(), np.where(faces < 0, scene.bounds[0, 2], tops) + height]


def checked(scene, eye, height):
    """The classes of all cells, after those that are certain have been compared with lines of sight through a tree."""
    points, pyramid = cells_of(scene, height), scene.engine.terrain.pyramid
    ends = receivers_above(points, 2, scene.origin, scene.middle)
    eyes = Receivers.in_space(np.array([eye]), scene.origin)
    tracing = TileTracer(scene, None, 0.0, 2, len(points))
    over = tracing.over(ends, None)
    classes = None if over is None else tracing.view(over, None, eyes.origins[0, 0], np.inf)
    if classes is None:
        return None
    seen = TileTracer(scene, TREE, 0.0, 2, len(points)).visible(ends, eyes)[:, 0] == 1
    assert not (~seen & (classes == SEEN)).any() and not (seen & (classes == HIDDEN)).any()
    open_cells = np.flatnonzero(~np.isnan(pyramid.tree.z.reshape(-1)) & (scene.data.cell_tops()[1] >= 0))
    exact = decided(pyramid.ground, eyes.origins[0, 0], open_cells, ends.origins[0, open_cells], 2)
    assert np.array_equal(exact, seen[open_cells])
    return classes


@examples(100)
@given(HEIGHTS, st.integers(0, 10_000), st.sampled_from([PLACE, OBLONG]), st.sampled_from([0.0, 0.5, -0.25]))
def test_certain_cells_have_the_bits_of_a_tree(heights, seed, place, height):
    scene, random = scene_of(heights, place), np.random.default_rng(seed)
    if scene is None:
        return
    low, high = scene.bounds
    for lift in 0.01, 1.0, 8.0:
        checked(scene, [*random.uniform(low[:2], high[:2]), low[2] + lift], height)
        surface = scene.data.source.surface
        row, column = random.integers(heights.shape[0]), random.integers(heights.shape[1])
        if not np.isnan(heights[row, column]):
            eye = surface.grid.eastings()[column], surface.grid.northings()[row], heights[row, column] + lift
            checked(scene, eye, height)


@examples(25)
@given(st.integers(0, 10_000), st.sampled_from([0.0, 1.0, 20.0]), st.sampled_from([0, 0, 40, 400]))
def test_certain_cells_have_the_bits_of_a_tree_on_rough_hills(seed, roughness, holes):
    random = np.random.default_rng(seed)
    y, x = np.mgrid[:190, :257]
    heights = 40.0 * np.sin(x / 13.0 + seed) * np.cos(y / 9.0) + roughness * random.normal(size=x.shape)
    heights[random.integers(0, 190, holes), random.integers(0, 257, holes)] = np.nan
    scene = scene_of(heights, PLACE)
    low, high = scene.bounds
    eye = [*random.uniform(low[:2], high[:2]), high[2] + random.choice([-5.0, 2.0, 50.0])]
    height = random.choice([0.0, 1.6])  # at 0, cells near the origin of the frame stay open: their lift is small
    classes = checked(scene, eye, height)
    if classes is not None and holes == 0 and height > 0.0:
        assert (classes == UNDECIDED).mean() < 0.02


@pytest.mark.parametrize("corner", [(1, 1), (1, -2), (-2, 1), (-2, -2)])
def test_eyes_in_all_corners_see_what_lines_of_sight_do(corner):
    y, x = np.mgrid[:150, :170]
    heights = 30.0 * np.sin(x / 11.0) * np.cos(y / 17.0)
    scene = scene_of(heights, PLACE)
    grid = scene.data.source.surface.grid
    eye = grid.eastings()[corner[1]], grid.northings()[corner[0]], heights[corner] + 20.0
    classes = checked(scene, eye, 0.0)
    assert (classes == UNDECIDED).mean() < 0.01 and min((classes == SEEN).sum(), (classes == HIDDEN).sum()) > 1000


def test_eyes_beside_the_grid_or_below_the_ground_have_no_view():
    z = np.zeros((4, 4), np.float32)
    ground = ground_of(np.arange(4, dtype=np.float32), -np.arange(4, dtype=np.float32), z)
    for eye in (-1.0, -1.0, 5.0), (1.5, -1.5, 0.0), (1.5, -1.5, -1.0), (1.5, 1.0, 5.0), (3.0, -3.0, 5.0):
        assert view_from(ground, np.array(eye, np.float32), 0.0, 1) is None
        assert view_from(ground, np.array(eye, np.float32), 0.0, 1, far=1.0) is None
    assert view_from(ground, np.array((1.5, -1.5, 1.0), np.float32), 0.0, 1) is not None
