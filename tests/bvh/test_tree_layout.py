"""Cutting a tree and writing it again: nothing is lost, and leaves are the cheapest."""

from unittest.mock import patch

import hypothesis.strategies as st
import numpy as np
from hypothesis import given

from antumbra.bvh import tree_layout
from antumbra.bvh.binned_sah import build
from antumbra.bvh.nodes import aligned_empty
from antumbra.bvh.tree_layout import PART, cheapest_leaves, cut_tree, relayout
from antumbra.bvh.tree_quality import sah_cost, statistics, validate
from antumbra.engine.method_registry import BUILDERS
from bvh_scenes import scattered, terrain
from strategies import soups
from strength import examples


def relaid(bvh, max_leaf=4, threads=1, largest=PART):
    with patch.object(tree_layout, "PART", largest):
        pieces = cut_tree(bvh)
    return relayout(bvh, pieces, cheapest_leaves(bvh, pieces, max_leaf, threads), threads)


@given(soup=soups(120), max_leaf=st.integers(1, 8), largest=st.integers(1, 30), name=st.sampled_from(sorted(BUILDERS)))
@examples(60)
def test_any_tree_and_cut(soup, max_leaf, largest, name):
    if len(soup) < 2:
        return
    bvh = BUILDERS[name].build(soup, 1, max_leaf=1)
    new = relaid(bvh, max_leaf, 2, largest)
    validate(new, soup)
    assert statistics(new).leaf_sizes[max_leaf + 1 :].sum() == 0
    assert sah_cost(new) <= sah_cost(bvh) * (1 + 1e-12)


def test_parts_hold_all_nodes_and_no_more_than_allowed():
    bvh = build(terrain(5000))
    with patch.object(tree_layout, "PART", 50):
        pieces = cut_tree(bvh)
    counts = [end - root for root, end, _ in pieces.parts if root >= 0]
    assert sum(counts) + len(pieces.numbers) == len(bvh.nodes) and max(counts) <= 50
    assert len(pieces.parts) == len(pieces.numbers) + 1
    assert pieces.parts[:, 2].max() > 5


def test_a_tree_in_its_final_form_stays_as_it_is():
    first = relaid(build(terrain(3000)))
    for a, b in zip(first, relaid(first, largest=100), strict=True):
        assert a.tobytes() == b.tobytes()


def test_nodes_in_any_order():
    """All nodes except the root are shuffled, and unused words hold junk."""
    vertices = scattered(500)
    bvh = build(vertices, 1, 1)
    n = len(bvh.nodes)
    to = np.concatenate([[0], 1 + np.random.default_rng(0).permutation(n - 1)])
    nodes = aligned_empty((n, 16), "f4")
    nodes[to] = bvh.nodes
    links = nodes.view(np.int32)
    links[:, 12:14] = np.where(links[:, 12:14] >= 0, to[np.maximum(links[:, 12:14], 0)], links[:, 12:14])
    links[:, 14:] = 12345
    pieces = cut_tree(bvh)
    shuffled = bvh._replace(nodes=nodes, links=links)
    new = relayout(shuffled, pieces, cheapest_leaves(shuffled, pieces, 4, 1), 1)
    for a, b in zip(new, relaid(bvh), strict=True):
        assert a.tobytes() == b.tobytes()
