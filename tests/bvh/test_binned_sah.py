"""Promises of `bsah` beyond those of all builders."""

import numpy as np
import pytest
from hypothesis import given

from antumbra.bvh import top_levels
from antumbra.bvh.binned_sah import build
from antumbra.bvh.binned_split import BINS, bin_count, must_halve
from antumbra.bvh.nodes import MAX_DEPTH, aligned_empty
from antumbra.bvh.tree_quality import sah_cost, statistics
from bvh_scenes import terrain
from reference_sah import binned_sah, half_area, least_sah_cost
from strategies import point_arrays
from strength import examples


@pytest.mark.parametrize("n", [1, 2, 3, 4])
@pytest.mark.parametrize("max_leaf", [1, 2, 4])
def test_few_triangles_have_the_best_tree(n, max_leaf):
    @examples(40)
    @given(points=point_arrays((n, 3)))
    def check(points):
        if n > 1 and half_area(points.min((0, 1)).astype(float), points.max((0, 1)).astype(float)) > 0:
            cost = sah_cost(build(points, 1, max_leaf))
            assert cost == pytest.approx(least_sah_cost(points, max_leaf), rel=1e-5)

    check()


def test_left_child_comes_right_behind_its_parent():
    for vertices in (terrain(3000), terrain(20_000)):
        left = build(vertices).links[:, 12]
        inner = np.flatnonzero(left >= 0)
        assert len(inner) > 100 and np.array_equal(left[inner], inner + 1)


@pytest.mark.parametrize("size", [0.6, 0.0])
def test_nodes_take_spare_memory_only_if_they_fill_most_of_it(monkeypatch, size):
    rng, taken, nodes_in = np.random.default_rng(0), [], top_levels._nodes_in
    vertices = (rng.random((5000, 1, 3)) * (size > 0) + size * rng.random((5000, 3, 3))).astype(np.float32)

    def recorded(memory, count):
        nodes = nodes_in(memory, count)
        taken.append((np.shares_memory(nodes, memory), nodes.nbytes / memory.nbytes))
        assert nodes.shape == (count, 16) and nodes.ctypes.data % 64 == 0
        return nodes

    for max_leaf in range(1, 9):
        monkeypatch.setattr(top_levels, "_nodes_in", recorded)
        tree = build(vertices, max_leaf=max_leaf)
        monkeypatch.setattr(top_levels, "_nodes_in", lambda memory, count: aligned_empty((count, 16), "f4"))
        expected = build(vertices, max_leaf=max_leaf)
        assert all(np.array_equal(a.view(np.int32), b.view(np.int32)) for a, b in zip(tree, expected))
    assert all(shared == (0.75 <= share <= 1) for shared, share in taken)
    shares = [share for _, share in taken]
    assert max(shares) > 1 and (min(shares) < 0.75 if size == 0 else any(shared for shared, _ in taken))


def test_halving_ends_in_time():
    """`must_halve` turns true as late as possible: halving from that depth on still ends by MAX_DEPTH."""
    for n in (2, 3, 4, 5, 7, 8, 9, 1000, 2**20 + 1, 2**28):
        depth = next(d for d in range(MAX_DEPTH) if must_halve(n, d))
        assert depth + int(np.ceil(np.log2(n))) <= MAX_DEPTH
        assert not must_halve(n, depth - 1) and must_halve(2 * n, depth - 1)


def test_tree_that_greedy_splits_would_make_too_deep():
    """Groups of triangles, each eight times as large and as far as the last. Greedy splits cut off one at a time."""
    sizes = 8.0 ** np.repeat(np.arange(-41, 40), 3)
    vertices = (sizes[:, None, None] * (1 + np.random.default_rng(0).random((len(sizes), 3, 3)))).astype(np.float32)
    shape = statistics(build(vertices, max_leaf=1))
    assert binned_sah(vertices, max_leaf=1)[1] > MAX_DEPTH + 8
    assert MAX_DEPTH - 8 < shape.depth <= MAX_DEPTH


def test_few_records_have_few_bins():
    assert [int(bin_count(n)) for n in (5, 16, 10**3, 10**6)] == [4, 5, BINS, BINS]
