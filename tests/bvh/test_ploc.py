"""Promises of `ploc` beyond those of all builders: it is the tree of locally-ordered clustering."""

import numpy as np
import pytest

from antumbra.bvh import lbvh, ploc
from antumbra.bvh.nodes import MAX_DEPTH
from antumbra.bvh.tree_quality import sah_cost, statistics, validate
from bvh_scenes import LARGE, integer_grid, scattered, terrain
from reference_morton import karras_tree, morton_codes
from reference_ploc import ploc_tree

SCENES = {
    "two": scattered(2),
    "three": scattered(3),
    "sixteen": scattered(16),
    "seventeen": scattered(17),
    "scattered": scattered(300),
    "terrain": terrain(400),
    "grid, with many ties": integer_grid(216),
    "copies": np.tile(scattered(9), (21, 1, 1)),
    "all equal": np.tile(scattered(1), (77, 1, 1)),
    "in two spots": np.concatenate([scattered(100) * np.float32(1e-4), scattered(100) + np.float32(50)]),
}


def growing(n):
    """Triangles around one point, from small to large: each is nearest to a smaller one, so few pairs merge."""
    return (np.linspace(0.1, 5, n)[:, None, None] * (np.eye(3) - 1 / 3)).astype(np.float32)


def tree_of(bvh, link=0):
    """The tree in the form of `ploc_tree`."""
    if link < 0:
        first, count = ~link >> 3, (~link & 7) + 1
        return tuple(bvh.prim_ids[first : first + count].tolist())
    return [tree_of(bvh, int(child)) for child in bvh.links[link, 12:14]]


@pytest.mark.parametrize("max_leaf", [1, 4, 8])
@pytest.mark.parametrize("name", SCENES)
def test_tree_is_that_of_the_clusters(name, max_leaf):
    vertices = SCENES[name]
    order = karras_tree(morton_codes(vertices, 10))[0]
    bvh = ploc.build(vertices, 1, max_leaf)
    assert tree_of(bvh) == ploc_tree(vertices, order, ploc.RADIUS, max_leaf)


@pytest.mark.parametrize("n", [300, 3 * LARGE])
def test_few_merges_per_round_make_no_deep_tree(n):
    vertices = growing(n)
    bvh = ploc.build(vertices, 2, 1)
    validate(bvh, vertices)
    assert (n - 1).bit_length() < statistics(bvh).depth <= MAX_DEPTH


def test_triangles_and_nodes_lie_depth_first():
    for vertices in (terrain(3000), terrain(LARGE)):
        bvh = ploc.build(vertices)
        left, right = bvh.links[:, 12], bvh.links[:, 13]
        inner = np.flatnonzero(left >= 0)
        assert len(inner) > 100 and np.array_equal(left[inner], inner + 1)
        leaves = [~link >> 3 for pair in zip(left, right) for link in pair if link < 0]
        assert len(leaves) == len(bvh.nodes) + 1 and sum(left < 0) > 100
        for node in np.flatnonzero((left < 0) & (right < 0)):
            assert ~right[node] >> 3 == (~left[node] >> 3) + (~left[node] & 7) + 1


@pytest.mark.parametrize("vertices", [terrain(LARGE), scattered(LARGE)], ids=["terrain", "scattered"])
def test_tree_of_many_ranges_is_the_same_for_any_number_of_threads(vertices, monkeypatch):
    monkeypatch.setattr(ploc, "_PER_THREAD", 1000)
    first = ploc.build(vertices, 1)
    validate(first, vertices)
    assert sah_cost(first) < 0.9 * sah_cost(lbvh.build(vertices))
    for threads in (2, 5):
        again = ploc.build(vertices, threads)
        assert all(a.tobytes() == b.tobytes() for a, b in zip(first, again, strict=True))
