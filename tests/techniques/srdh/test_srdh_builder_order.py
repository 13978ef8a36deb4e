"""Ordering the children of an existing tree by the cost of rays."""

import hypothesis.strategies as st
import numpy as np
import pytest
from hypothesis import given

import oracle
from antumbra.bvh import binned_sah
from antumbra.bvh.nodes import LEFT_FIRST, UNORDERED
from antumbra.bvh.tree_quality import sah_cost, validate
from antumbra.engine.method_registry import BUILDERS, OPTIMISERS
from antumbra.techniques.srdh.srdh_builder import order_by_rays
from antumbra.trace.rays.ray_traversal import RANDOM, SRDH
from bvh_scenes import HAZARDS, scattered, terrain
from reference_srdh import box_of, pierces, scene_of
from shadow_rays import met, met_in, nested, segments_in, walked
from strategies import soups
from strength import examples


@examples(60)
@given(
    vertices=soups(120), seed=st.integers(0, 2**32 - 1), m=st.integers(0, 60), name=st.sampled_from(["bsah", "lbvh"])
)
def test_any_soup_and_rays(vertices, seed, m, name):
    bvh = BUILDERS[name].build(vertices, 1)
    before = bvh.nodes.tobytes()
    ordered = order_by_rays(bvh, 1, rays=met_in(vertices, m, seed))
    validate(ordered, vertices)
    assert bvh.nodes.tobytes() == before and sah_cost(ordered) == pytest.approx(sah_cost(bvh), rel=1e-9)
    left = ordered.links[:, 12]
    assert np.array_equal(left[left >= 0], np.flatnonzero(left >= 0) + 1)


@pytest.mark.parametrize("name", HAZARDS)
def test_hazards(name):
    vertices = np.ascontiguousarray(HAZARDS[name], np.float32)
    validate(order_by_rays(binned_sah.build(vertices), rays=met_in(vertices)), vertices)


def test_without_rays_it_is_the_tree_itself():
    bvh = binned_sah.build(scattered(50))
    assert order_by_rays(bvh) is bvh and OPTIMISERS["srdh-order"].optimise(bvh, 2) is bvh
    assert order_by_rays(bvh, rays=met(scattered(50), *np.zeros((2, 0, 3), np.float32))) is bvh


def test_same_bits_for_any_number_of_threads():
    vertices = terrain(4000)
    bvh, rays = binned_sah.build(vertices), met_in(vertices, 1000)
    first = order_by_rays(bvh, 1, rays=rays)
    assert 0.1 < (first.links[:, 14] == LEFT_FIRST).mean() < 1
    for threads in (2, 3, None):
        again = order_by_rays(bvh, threads, rays=rays)
        assert all(a.tobytes() == b.tobytes() for a, b in zip(first, again, strict=True))


@pytest.mark.parametrize("max_leaf", [1, 4])
def test_at_each_node_the_order_costs_least(max_leaf):
    """The cost is the metric of Sec. 3.2, with boxes and triangles at 1 each.

    A node's rays are those that reach it by the orders of the nodes above.
    """
    vertices = scattered(120, 3)
    origins, ends = segments_in(vertices, 200, 4)
    scene = scene_of(vertices, origins, ends, oracle.all_hits(vertices, origins, ends))
    bvh = binned_sah.build(vertices, 1, max_leaf)
    ordered = order_by_rays(bvh, 1, rays=met(vertices, origins, ends))
    ids_of = lambda tree: tree if isinstance(tree, list) else ids_of(tree[0]) + ids_of(tree[1])
    chosen = {}

    def note(tree):
        if not isinstance(tree, list):
            chosen[frozenset(ids_of(tree))] = frozenset(ids_of(tree[0])), tree[2]
            note(tree[0])
            note(tree[1])

    def check(tree, comes):
        """(C, H) of a tree. `comes` tells which rays reach it."""
        ids = ids_of(tree)
        enters = pierces(box_of(scene, ids), scene.origins, scene.ends)
        if isinstance(tree, list):
            return 1 + enters * len(ids), scene.hits[:, ids].any(1)
        whole = tree is root or enters
        a, h = check(tree[0], comes & whole)
        b, g = check(tree[1], comes & whole & ~h)
        gain = int((comes & whole) @ (g * a - h * b))
        first, word = chosen[frozenset(ids)]
        assert word == (LEFT_FIRST if gain else UNORDERED)
        assert first == frozenset(ids_of(tree[1] if gain > 0 else tree[0]))
        gains.append(gain)
        return 1 + enters * (a + ~h * b), h | g

    gains, root = [], nested(bvh)
    note(nested(ordered))
    check(root, np.ones(len(origins), bool))
    assert min(gains) < 0 < max(gains) and 0 in gains
    few, many = (walked(tree, order, origins, ends)[2].sum() for tree, order in ((ordered, SRDH), (bvh, RANDOM)))
    assert few < many
