"""Promises of treelet restructuring beyond those of all builders."""

from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given

from antumbra.bvh import lbvh, tree_layout
from antumbra.bvh.nodes import MAX_DEPTH
from antumbra.bvh.tree_quality import sah_cost, statistics, validate
from antumbra.lab.builders.tl_lbvh import LEAVES, build, restructure
from bvh_scenes import HAZARDS, chain, scattered, terrain
from reference_sah import half_area, least_sah_cost
from strategies import point_arrays, soups
from strength import examples


@pytest.mark.parametrize("max_leaf", [1, 2, 4, 8])
def test_one_treelet_has_the_best_of_all_trees(max_leaf):
    @examples(15)
    @given(points=point_arrays((LEAVES, 3)))
    def check(points):
        if half_area(points.min((0, 1)).astype(float), points.max((0, 1)).astype(float)) > 0:
            bvh = build(points, 1, max_leaf)
            validate(bvh, points)
            assert sah_cost(bvh) == pytest.approx(least_sah_cost(points, max_leaf), rel=1e-5)

    check()


@given(vertices=soups(200) | point_arrays((90, 3)))
@examples(40)
def test_rounds_never_make_a_tree_worse(vertices):
    if len(vertices) > 1:
        costs = [sah_cost(restructure(lbvh.build(vertices, 1, 1), 4, 1, rounds)) for rounds in range(4)]
        assert all(b <= a * (1 + 1e-5) for a, b in pairwise(costs))


@pytest.mark.parametrize("name", HAZARDS)
def test_parts_and_top(name, monkeypatch):
    """With parts of at most 20 nodes, most treelets are in the top."""
    monkeypatch.setattr(tree_layout, "PART", 20)
    vertices = np.ascontiguousarray(HAZARDS[name][:3000], np.float32)
    for threads in (1, 3):
        validate(build(vertices, threads), vertices)


def test_parts_cost_little_quality(monkeypatch):
    whole = sah_cost(build(terrain(4000)))
    monkeypatch.setattr(tree_layout, "PART", 100)
    assert sah_cost(build(terrain(4000))) < 1.02 * whole


def test_no_path_becomes_too_long():
    """A tree of the greatest depth, with equal boxes. A chain of them would cost the same."""
    bvh, vertices = chain(MAX_DEPTH + 1)
    before = sah_cost(bvh)
    after = restructure(bvh, 1, 1)
    validate(after, vertices)
    assert sah_cost(after) < before


def test_treelets_are_worth_it():
    for vertices in (terrain(20_000), scattered(20_000)):
        cost = sah_cost(build(vertices))
        assert cost < 0.95 * sah_cost(lbvh.build(vertices))
        assert statistics(build(vertices)).depth < 40
