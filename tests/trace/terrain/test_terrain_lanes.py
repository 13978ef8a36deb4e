"""Parallel rays over terrain, 16 at a time along stencils: the bits of trees, and few undecided rays."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import antumbra as at
from antumbra.engine.sources import terrain_shadows
from antumbra.query.shadow_query import new_bits
from antumbra.trace.terrain.terrain_lanes import trace_stencils
from antumbra.trace.terrain.terrain_rays import terrain_tree
from antumbra.trace.terrain.terrain_stencils import NO_SURFACE, ROW_PAD, relief_of, stencils_of
from strength import examples
from terrain_scenes import cells_of, query_of, rasters, scene_of, suns

PLACE = (2.0, 0.0, 84000.0, 0.0, -3.0, 446000.0)
TREE = "bsah+wide"
HEIGHTS = rasters(26, 45, [0.0, 0.0, 0.0, 0.25, 1.0, 3.0, 9.0, np.nan])


@examples(120)
@given(HEIGHTS, st.integers(0, 10_000), st.sampled_from([0.0, 0.01, 0.5]))
def test_bits_are_those_of_trees(heights, seed, lift):
    scene, random = scene_of(heights, PLACE), np.random.default_rng(seed)
    if scene is None:
        return
    points = cells_of(scene) + [0.0, 0.0, lift]
    lights = at.DirectionalLights(-suns(random, 20))
    for normals in None, np.broadcast_to((0.0, 0.0, 1.0), points.shape):
        bits, trees = (at.visibility(scene, points, lights, normals, plan=p).bits for p in (None, TREE))
        assert (bits == trees).all()


@examples(25)
@given(st.integers(0, 10_000), st.sampled_from([0.02, 1.0, 20.0]), st.sampled_from([0, 40, 400]))
def test_bits_are_those_of_trees_on_rough_hills(seed, roughness, holes):
    random = np.random.default_rng(seed)
    y, x = np.mgrid[:90, :117]
    heights = 40.0 * np.sin(x / 13.0 + seed) * np.cos(y / 9.0) + roughness * random.normal(size=x.shape)
    heights[random.integers(0, 90, holes), random.integers(0, 117, holes)] = np.nan
    scene = at.from_raster((heights, PLACE))
    cells, lights = cells_of(scene), at.DirectionalLights(-suns(random, 10))
    up = np.broadcast_to((0.0, 0.0, 1.0), cells.shape)
    bits, trees = (at.visibility(scene, cells, lights, up, plan=plan) for plan in (None, TREE))
    assert (bits.bits == trees.bits).all() and 0.01 < bits.seen_samples.mean() < 0.99


@pytest.mark.parametrize("holes", [0, 30])
def test_lanes_decide_nearly_all_rays(holes):
    random = np.random.default_rng(0)
    y, x = np.mgrid[:120, :150]
    heights = 40.0 * np.sin(x / 13.0) * np.cos(y / 9.0)
    heights[random.integers(0, 120, holes), random.integers(0, 150, holes)] = np.nan
    scene = at.from_raster((heights, PLACE))
    lights = at.DirectionalLights(-suns(random, 20))
    tree, query = query_of(scene, lights)
    relief = relief_of(tree)
    offsets = query.light.base + query.samples[0] @ np.stack([query.light.u, query.light.v, query.light.w])
    stencils = stencils_of(tree, relief, offsets)
    assert (np.diff(stencils.steps) > 0).all()
    bits, by_lanes = new_bits(query), new_bits(query)
    trace_stencils(tree, relief, stencils, query, bits, 1, None)
    blind = tree._replace(tops=np.full_like(tree.tops, -np.inf))  # exact rays meet nothing
    trace_stencils(blind, relief, stencils, query, by_lanes, 1, None)
    count, decided = (int(np.bitwise_count(each).sum()) for each in (bits, by_lanes))
    assert count > 100_000 and not (by_lanes & ~bits).any()
    assert decided > (0.98 if holes == 0 else 0.9) * count


def test_the_relief_borders_the_surface():
    heights = np.random.default_rng(5).integers(0, 40, (11, 18)) / 4.0
    heights[3, 4] = np.nan
    scene = at.from_raster((heights, PLACE))
    tree = terrain_tree(scene.data.source.surface, scene.origin)
    relief = relief_of(tree)
    rows = relief.high[ROW_PAD:-ROW_PAD, 20:-20]
    there = np.isfinite(tree.z)
    assert (rows[there] == tree.z[there]).all() and rows[3, 4] == tree.z[2:5, 3:6][there[2:5, 3:6]].max()
    assert relief.high[ROW_PAD - 1, 25] == tree.z[0, 4:7].max() and relief.high[ROW_PAD - 2, 25] == NO_SURFACE
    solid = relief.low[ROW_PAD:-ROW_PAD, 20:-20] > NO_SURFACE
    assert solid[1:-1, 1:-1].sum() == 9 * 16 - 7 and not (solid[0].any() or solid[:, -1].any())
    assert relief.whole == 0 and relief.shift < 1e-3


def test_coarse_coordinates_have_no_stencils():
    """Far from its origin, float32 moves the vertices of a fine grid by too large a part of a cell."""
    scene = at.from_raster((np.zeros((9, 9)), (1.0, 0.0, 0.0, 0.0, -1.0, 0.0)))
    tree = terrain_tree(scene.data.source.surface, scene.origin)
    sun = np.array([[30.0, 40.0, 20.0]])
    assert stencils_of(tree, relief_of(tree), sun) is not None
    moved = tree._replace(x=tree.x + np.float32(0.1))
    assert stencils_of(moved, relief_of(moved), sun) is None


def test_rows_of_sensors_are_traced_without_trees(monkeypatch):
    scene = at.from_raster((np.random.default_rng(0).integers(0, 40, (30, 40)) / 4.0, PLACE))
    monkeypatch.setattr(terrain_shadows, "_RAYS_PER_TRIANGLE", 0)
    cells, lights = cells_of(scene), at.DirectionalLights(-suns(np.random.default_rng(1), 9))
    at.visibility(scene, cells, lights)
    assert scene.engine.terrain.pyramid._relief is not None
    other = at.from_raster((np.random.default_rng(0).integers(0, 40, (30, 40)) / 4.0, PLACE))
    at.visibility(other, cells[::2], lights)
    assert other.engine.terrain.pyramid._tree is None


def test_sun_hours_do_not_depend_on_the_order_of_sensors():
    heights = np.random.default_rng(3).integers(0, 60, (40, 50)) / 4.0
    scene = at.from_raster((heights, (2.0, 0.0, 84000.0, 0.0, -2.0, 446000.0), "EPSG:28992"))
    hours, expected = (at.sun_hours(scene, "raster", "2026-03-21", plan=plan)["sun_hours"] for plan in (None, TREE))
    assert (hours == expected).all() and len(np.unique(hours)) > 3
    assert scene.engine.terrain.pyramid._relief is not None
