"""How long reinsertion goes on. Its trees are tested in test_optimisers.py."""

import numpy as np
import pytest

from antumbra.bvh import reinsertion
from antumbra.bvh.binned_sah import build
from antumbra.bvh.tree_quality import sah_cost, validate
from bvh_scenes import scattered


def _concentric(n):
    """Triangles with one centroid, of all sizes: bounds exclude few places."""
    rng = np.random.default_rng(36)
    corners = rng.normal(size=(n, 3, 3)) * 2.0 ** -rng.integers(0, 16, (n, 1, 1))
    corners[:, 2] = -corners[:, 0] - corners[:, 1]
    return corners.astype(np.float32)


@pytest.mark.parametrize("soup, rounds", [(_concentric, 1), (scattered, 5)])
def test_costly_rounds_are_the_last(monkeypatch, soup, rounds):
    searched, run = [], reinsertion.run

    def counted(kernel, *arguments):
        searched.append(kernel is reinsertion.find_places)
        return run(kernel, *arguments)

    monkeypatch.setattr(reinsertion, "run", counted)
    vertices = np.ascontiguousarray(soup(3000), np.float32)
    bvh = build(vertices, 1)
    better = reinsertion.reinsert(bvh, 1)
    assert sum(searched) == rounds
    validate(better, vertices)
    assert sah_cost(better) < sah_cost(bvh)


def _candidates(monkeypatch, vertices):
    """The number of candidates in each round, relative to the number of items, and the tree."""
    numbers, run = [], reinsertion.run

    def counted(kernel, threads, ticket, *arguments):
        if kernel is reinsertion.find_places:
            loose, candidates, _ = arguments
            numbers.append(len(candidates) / len(loose.parents))
            areas = loose.boxes[:, 3]
            assert areas[candidates].min() >= np.delete(areas, candidates).max(initial=0.0)
        return run(kernel, threads, ticket, *arguments)

    monkeypatch.setattr(reinsertion, "run", counted)
    return numbers, reinsertion.reinsert(build(vertices, 1), 1)


def test_only_the_largest_subtrees_move_where_they_gain_most(monkeypatch):
    """A few large triangles, and many small ones in a corner."""
    large, small = scattered(600), 1e-3 * scattered(20_000)
    vertices = np.concatenate([large, small]).astype(np.float32)
    shares, tree = _candidates(monkeypatch, vertices)
    assert len(shares) > 1 and max(shares) < 0.15
    validate(tree, vertices)
    assert sah_cost(tree) < sah_cost(build(vertices, 1))


def test_more_subtrees_move_where_all_of_them_gain(monkeypatch):
    vertices = np.ascontiguousarray(scattered(20_000), np.float32)
    shares, tree = _candidates(monkeypatch, vertices)
    assert shares[0] < 0.15 and shares[-1] > 0.5
    validate(tree, vertices)
