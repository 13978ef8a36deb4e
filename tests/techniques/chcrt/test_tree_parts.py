"""Fronts from frame to frame: in a walk, they have about as many pairs as fresh ones; they outlive refits."""

import numpy as np
import pytest

import antumbra as at
from antumbra.bvh.block_tree import block_tree
from antumbra.bvh.refit import refit
from antumbra.engine.auto_accelerator import accelerator_of
from antumbra.engine.method_registry import BUILDERS
from antumbra.engine.plan import parse_plan
from antumbra.query.ray_passes import RayPass
from antumbra.techniques.chcrt.chc_rt import ChcRtState, ray_hits, trace_shadow
from antumbra.techniques.chcrt.occlusion_queries import Pairs
from antumbra.techniques.chcrt.picture_ray_sets import SegmentRaySets, segments_of
from antumbra.techniques.chcrt.tree_parts import matching_rows, parts_of
from antumbra.techniques.tracer_options import ChcRtOptions
from asking import answer, query_of, unpack

OPTIONS = ChcRtOptions(tile=32, triangles=512)
LIGHTS = {"quad": at.QuadLight((10, 60, -10), (6, 0, 0), (0, 0, 6)), "sky": at.AmbientOcclusion(4.0)}
SPP, FRAMES = 4, 10


@pytest.fixture(scope="module")
def city():
    return at.procedural("city", triangles=40_000)


@pytest.fixture(scope="module")
def triangles(city):
    return city.triangles()


def _tree(triangles):
    return BUILDERS["bsah"].build(triangles.vertices, 2)


def _state(bvh, **options):
    options = OPTIONS._replace(**options)
    return ChcRtState(parts_of(block_tree(bvh, 2), options), options)


def _bits(state, query):
    bits = np.zeros((*query.sides.shape, 1), np.uint64)
    trace_shadow(state, query, bits, 2)
    return bits


def _step(city, k):
    """The camera after k steps along a street."""
    return at.Camera((1.5, 1.7, 45.0 - 1.5 * k), (1.5 + 0.3 * k, 2.2, 20.0 - 1.5 * k), vfov=60.0, width=160, height=96)


STILL = _step(None, 0)


@pytest.mark.parametrize("light", LIGHTS)
def test_a_walk_has_the_pairs_of_fresh_frames(city, triangles, light):
    bvh = _tree(triangles)
    kept, fresh = _state(bvh), _state(bvh, keep=False)
    assert len(kept.parts.trees) > 50
    visible, queries = np.zeros((2, FRAMES)), np.zeros((2, FRAMES))
    for k in range(FRAMES):
        _, query = query_of(city, _step(city, k), LIGHTS[light], SPP)
        bits = []
        for i, state in enumerate((kept, fresh)):
            state.begin()
            bits.append(_bits(state, query))
            (counts,) = state.statistics
            visible[i, k], queries[i, k] = counts["visible"], counts["queries"]
        np.testing.assert_array_equal(*bits)
        assert 0.01 < np.bitwise_count(bits[0]).mean() / SPP < 0.99
    late = slice(FRAMES // 2, None)
    assert visible[1].min() > 50 and visible[0, late].sum() <= 1.02 * visible[1, late].sum()
    assert queries[0, late].sum() < 0.7 * queries[1, late].sum()


@pytest.mark.parametrize("light", LIGHTS)
def test_the_marked_pairs_block_all_rays(city, triangles, light):
    parts, (_, query) = _state(_tree(triangles)).parts, query_of(city, STILL, LIGHTS[light], SPP)
    (step,) = segments_of(parts, query)

    def trace(chosen):
        bits = np.zeros((*query.sides.shape, 1), np.uint64)
        rays = SegmentRaySets(parts, OPTIONS, step, bits, 2)
        grid = np.indices((rays.tiles.smallest, rays.sets, len(parts.trees)), np.int32).reshape(3, -1)[:, chosen]
        pairs = Pairs(grid[0], grid[1], grid[2] + np.int32(parts.inner))
        return bits, rays.trace(pairs, np.zeros(len(pairs.tile), np.float32))

    bits, marked = trace(slice(None))
    np.testing.assert_array_equal(bits, _bits(_state(_tree(triangles)), query))
    assert 0.001 < marked.mean() < 0.5
    again, still_marked = trace(marked)
    np.testing.assert_array_equal(again, bits)
    assert still_marked.all()
    without, _ = trace(~marked)
    assert not (without & ~bits).any() and np.bitwise_count(without).sum() < np.bitwise_count(bits).sum()


class _Waves:
    """The city at a moment, in which its triangles have moved by less than the width of a street."""

    def __init__(self, triangles, k):
        moved = triangles.vertices + 0.4 * np.sin(0.3 * triangles.vertices[..., [1, 2, 0]] + k).astype(np.float32)
        self.moved = triangles._replace(vertices=np.ascontiguousarray(moved, np.float32))

    def triangles(self, time):
        return self.moved

    def query(self):
        return query_of(self, STILL, LIGHTS["quad"], SPP)


def test_fronts_continue_over_refitted_trees(triangles):
    moved, query = _Waves(triangles, 0).query()
    bvh = _tree(moved)
    state = _state(bvh)
    _bits(state, query)
    visible, swapped = {state.statistics[0]["visible"]}, False
    for k in range(1, 5):
        moved, query = _Waves(triangles, k).query()
        bvh = refit(bvh, moved.vertices, 2)
        refitted, fresh = _state(bvh), _state(bvh)
        swapped |= not np.array_equal(refitted.parts.links, state.parts.links)
        refitted.continue_from(state)
        state = refitted
        bits = _bits(state, query)
        np.testing.assert_array_equal(bits, _bits(fresh, query))
        np.testing.assert_array_equal(unpack(bits, SPP), answer(parse_plan("bsah+single"), moved, query))
        visible.add(state.statistics[0]["visible"])
        assert state.statistics[0]["queries"] < 0.8 * fresh.statistics[0]["queries"]
    assert swapped and len(visible) > 1


def test_rows_match_by_their_nodes(triangles):
    bvh = _tree(triangles)
    parts = _state(bvh).parts
    moved = _Waves(triangles, 2).moved
    same, rebuilt = _state(refit(bvh, moved.vertices, 2)).parts, _state(_tree(moved)).parts
    rows = matching_rows(parts, same)
    np.testing.assert_array_equal(parts.links, same.links[rows])
    np.testing.assert_array_equal(matching_rows(parts, parts), np.arange(len(rows)))
    assert matching_rows(parts, rebuilt) is None and matching_rows(parts, _state(bvh, triangles=64).parts) is None


def test_fronts_of_another_tree_are_dropped(city, triangles):
    _, query = query_of(city, _step(city, 0), LIGHTS["quad"], SPP)
    state, other = _state(_tree(triangles)), _state(_tree(triangles), triangles=64)
    _bits(state, query)
    other.continue_from(state)
    np.testing.assert_array_equal(_bits(other, query), _bits(_state(_tree(triangles)), query))
    assert list(state.states()) and other.statistics[0]["queries"] > state.statistics[0]["queries"]


def test_an_accelerator_keeps_fronts_over_refitted_trees(triangles):
    queries = {}
    for plan in ("bsah+refit+chcrt", "bsah+chcrt"):
        accelerator, queries[plan] = accelerator_of(parse_plan(plan), 2), []
        for k in range(3):
            moved, query = _Waves(triangles, k).query()
            ready = accelerator.build(moved)
            bits = accelerator.answer(ready, query)
            np.testing.assert_array_equal(unpack(bits, SPP), answer(parse_plan("bsah+single"), moved, query))
            queries[plan].append(ready.scheduled.statistics[0]["queries"])
    first, *later = queries["bsah+refit+chcrt"]
    assert max(later) < first and min(queries["bsah+chcrt"]) > max(later)


def test_lists_of_any_hit_rays_keep_their_blockers(triangles):
    """A pair that blocked rays in one call is visible in the next, so that few pairs are queried."""
    rng = np.random.default_rng(3)
    m, low, high = 20_000, *np.percentile(triangles.vertices.reshape(-1, 3), [2, 98], 0)
    origins = rng.uniform(low, high, (m, 3)).astype(np.float32)
    origins = origins[np.lexsort(np.floor(origins / 20).T)]
    rays = RayPass(origins, rng.normal(size=(m, 3)).astype(np.float32), np.full(m, -1, np.int32))
    state, found, queries = _state(_tree(triangles)), [], []
    for _ in range(3):
        state.begin()
        found.append(ray_hits(state, rays, np.tile([0.0, 20.0], (m, 1)), 0, True, 2).face[0] >= 0)
        queries.append(state.statistics[0]["queries"])
    assert 0.05 < found[0].mean() < 0.95 and max(queries[1:]) < queries[0] / 4
    np.testing.assert_array_equal(found[0], found[2])
