"""Terrain with a border in its grid, and one copy of its heights: the bits of terrain in memory."""

from copy import copy

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import antumbra as at
from antumbra.query.shadow_query import new_bits
from antumbra.trace.terrain.bordered_terrain import INSIDE, bordered_shape, bordered_terrain
from antumbra.trace.terrain.terrain_lanes import trace_stencils
from antumbra.trace.terrain.terrain_rays import terrain_tree
from antumbra.trace.terrain.terrain_stencils import stencils_of
from strength import examples
from terrain_scenes import cells_of, query_of, rasters, scene_of, suns

PLACE = (2.0, 0.0, 84000.0, 0.0, -3.0, 446000.0)
HEIGHTS = rasters(26, 45, [0.0, 0.0, 0.0, 0.25, 1.0, 3.0, 9.0, np.nan])


def bordered(scene):
    """The bordered terrain of a scene."""
    surface = scene.data.source.surface
    inside = terrain_tree(surface, scene.origin).z
    z = np.full(bordered_shape(*inside.shape), np.nan, np.float32)
    z[INSIDE] = inside
    return bordered_terrain(surface.grid, z, scene.origin)


def with_border(scene):
    """The same scene, whose rays are those of bordered terrain."""
    data, made = copy(scene.data), bordered(scene)
    data.terrain_towards = lambda *_: made
    return at.Scene.of_data(data)


def hills(seed, shape, roughness, holes):
    random = np.random.default_rng(seed)
    y, x = np.mgrid[: shape[0], : shape[1]]
    heights = 40.0 * np.sin(x / 13.0 + seed) * np.cos(y / 9.0) + roughness * random.normal(size=x.shape)
    heights[random.integers(0, shape[0], holes), random.integers(0, shape[1], holes)] = np.nan
    return heights


@examples(60)
@given(HEIGHTS, st.integers(0, 10_000), st.sampled_from([0.0, 0.01, 0.5]))
def test_bits_are_those_of_terrain_in_memory(heights, seed, lift):
    scene, random = scene_of(heights, PLACE), np.random.default_rng(seed)
    if scene is None:
        return
    large, points = with_border(scene), cells_of(scene) + [0.0, 0.0, lift]
    lights = at.DirectionalLights(-suns(random, 20))
    for normals in None, np.broadcast_to((0.0, 0.0, 1.0), points.shape):
        bits, others = (at.visibility(each, points, lights, normals).bits for each in (scene, large))
        assert (bits == others).all()


@pytest.mark.parametrize("shape", [(90, 117), (117, 90)])
@pytest.mark.parametrize("roughness, holes", [(0.02, 0), (1.0, 40), (20.0, 400)])
def test_bits_are_those_of_terrain_in_memory_on_rough_hills(shape, roughness, holes):
    scene, random = at.from_raster((hills(3, shape, roughness, holes), PLACE)), np.random.default_rng(holes)
    cells, lights = cells_of(scene), at.DirectionalLights(-suns(random, 10))
    up = np.broadcast_to((0.0, 0.0, 1.0), cells.shape)
    bits, others = (at.visibility(each, cells, lights, up) for each in (scene, with_border(scene)))
    assert (bits.bits == others.bits).all() and 0.01 < bits.seen_samples.mean() < 0.99


@pytest.mark.parametrize("holes", [0, 60])
def test_rays_of_lists_meet_the_same_triangles(holes):
    scene, random = at.from_raster((hills(5, (70, 90), 2.0, holes), PLACE)), np.random.default_rng(1)
    large, (low, high) = with_border(scene), scene.bounds
    begins = random.uniform(low - [5.0, 5.0, 20.0], high + [5.0, 5.0, 60.0], (4000, 3))
    along = random.normal(size=(4000, 3)) * [1.0, 1.0, 0.3]
    hits, others = (each.closest_hit(begins, along) for each in (scene, large))
    assert (hits.face == others.face).all() and np.array_equal(hits.t, others.t, equal_nan=True)
    assert (scene.occluded(begins, along) == large.occluded(begins, along)).all() and 0.1 < hits.mask.mean() < 0.95


def test_lanes_decide_nearly_all_rays_away_from_the_border():
    scene = at.from_raster((hills(0, (330, 360), 0.0, 0), PLACE))
    lights = at.DirectionalLights(-suns(np.random.default_rng(0), 10))
    _, query = query_of(scene, lights)
    tree, relief = bordered(scene)
    offsets = query.light.base + query.samples[0] @ np.stack([query.light.u, query.light.v, query.light.w])
    stencils = stencils_of(tree, relief, offsets)
    bits, by_lanes = new_bits(query), new_bits(query)
    trace_stencils(tree, relief, stencils, query, bits, 1, None)
    blind = tree._replace(tops=np.full_like(tree.tops, -np.inf), under=np.inf)  # exact rays meet nothing
    trace_stencils(blind, relief, stencils, query, by_lanes, 1, None)
    inside = np.zeros((330, 360), bool)
    inside[120:-120, 120:-120] = True
    count, decided = (int(np.bitwise_count(each.reshape(-1)[inside.reshape(-1)]).sum()) for each in (bits, by_lanes))
    assert count > 10_000 and not (by_lanes & ~bits).any() and decided > 0.9 * count
