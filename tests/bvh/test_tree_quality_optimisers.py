"""Promises of all optimisers, tested on the trees of every builder. Optimisers for rays get some."""

import hypothesis.strategies as st
import numpy as np
import pytest
from hypothesis import given

from antumbra.bvh.binned_sah import build
from antumbra.bvh.nodes import MAX_DEPTH
from antumbra.bvh.tree_quality import sah_cost, statistics, validate
from antumbra.engine.method_registry import BUILDERS, OPTIMISERS
from bvh_scenes import HAZARDS, chain, scattered, terrain
from shadow_rays import met_in
from strategies import point_arrays, soups
from strength import examples


def _shown(optimiser):
    """The `optimise` of an optimiser, with rays through the triangles if it takes rays."""
    if not optimiser.wants_rays:
        return optimiser.optimise

    def optimise(bvh, threads=None):
        vertices = np.empty((len(bvh.prim_ids), 3, 3), np.float32)
        vertices[bvh.prim_ids] = bvh.corners.reshape(-1, 3, 3)
        return optimiser.optimise(bvh, threads, rays=met_in(vertices))

    return optimise


pytestmark = pytest.mark.parametrize("optimise", [_shown(o) for o in OPTIMISERS.values()], ids=list(OPTIMISERS))
OF_SHAPES = [o.optimise for o in OPTIMISERS.values() if not o.wants_rays]  # the others choose orders of children only
builders = pytest.mark.parametrize("name", BUILDERS)


def check(optimise, bvh, vertices, threads=None):
    """Optimise a tree; check that the result is correct and costs no more; return it."""
    before = [a.tobytes() for a in bvh]
    better = optimise(bvh, threads)
    validate(better, vertices)
    assert [a.tobytes() for a in bvh] == before
    assert sah_cost(better) <= sah_cost(bvh) * (1 if optimise in OF_SHAPES else 1 + 1e-12)  # summed in another order
    return better


@builders
@pytest.mark.parametrize("hazard", [h for h in HAZARDS if not h.startswith("large, ")])
def test_hazards(optimise, name, hazard):
    vertices = np.ascontiguousarray(HAZARDS[hazard], np.float32)
    check(optimise, BUILDERS[name].build(vertices, 1), vertices)


@examples(60)
@given(vertices=soups(150) | point_arrays((30, 3)), name=st.sampled_from(sorted(BUILDERS)), max_leaf=st.integers(1, 8))
def test_any_soup(optimise, vertices, name, max_leaf):
    better = check(optimise, BUILDERS[name].build(vertices, 1, max_leaf=max_leaf), vertices, 1)
    assert statistics(better).leaf_sizes[max_leaf + 1 :].sum() == 0


@pytest.mark.parametrize("hazard", ["large, scattered", "large, terrain", "large, identical"])
def test_same_bits_for_any_number_of_threads(optimise, hazard):
    vertices = np.ascontiguousarray(HAZARDS[hazard], np.float32)
    bvh = BUILDERS["lbvh"].build(vertices)
    first = check(optimise, bvh, vertices, 1)
    for threads in (2, 3):
        assert all(a.tobytes() == b.tobytes() for a, b in zip(first, optimise(bvh, threads), strict=True))


def test_trees_become_much_better(optimise):
    if optimise not in OF_SHAPES:
        pytest.skip("costs what it did, by the surface area heuristic")
    for vertices in (terrain(6000), scattered(6000)):
        morton, sah = BUILDERS["lbvh"].build(vertices), build(vertices)
        assert sah_cost(optimise(morton)) < 0.96 * sah_cost(morton)
        assert sah_cost(optimise(sah)) < 0.99 * sah_cost(sah)


def test_no_path_becomes_too_long(optimise):
    bvh, vertices = chain(MAX_DEPTH + 1)
    better = check(optimise, bvh, vertices)
    assert statistics(better).depth <= MAX_DEPTH
    assert optimise not in OF_SHAPES or sah_cost(better) < sah_cost(bvh)


def test_left_child_comes_right_behind_its_parent(optimise):
    links = optimise(build(terrain(3000))).links[:, 12]
    inner = np.flatnonzero(links >= 0)
    assert np.array_equal(links[inner], inner + 1)
