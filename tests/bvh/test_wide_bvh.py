"""The wide BVH is correct: every triangle is in one leaf, and every box bounds everything below it."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from antumbra.bvh import wide_bvh
from antumbra.bvh.nodes import EMPTY, LINK, LINKS, NO_CHILD, WIDTH, bvh_leaf
from antumbra.bvh.wide_bvh import widen
from antumbra.engine.method_registry import BUILDERS
from bvh_scenes import HAZARDS
from strategies import point_arrays, soups
from strength import examples
from wide_trees import check_tree


def _check(vertices, max_leaf=4, threads=2):
    """Build a tree and check it; return the number of wide nodes."""
    vertices = np.ascontiguousarray(vertices, np.float32)
    bvh = BUILDERS["bsah"].build(vertices, threads, max_leaf)
    return check_tree(widen(bvh, threads), bvh, vertices)


@pytest.mark.parametrize("name", [n for n in HAZARDS if not n.startswith("large, ")])
def test_hazards(name):
    _check(HAZARDS[name])


@given(
    vertices=soups(200) | point_arrays((30, 3)) | point_arrays((3, 3)),
    max_leaf=st.integers(1, 8),
    subtrees=st.sampled_from([2, 5, 128]),
)
@examples(40)
def test_any_soup_leaf_size_and_number_of_subtrees(vertices, max_leaf, subtrees):
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(wide_bvh, "_SUBTREES", subtrees)
        patch.setattr(wide_bvh, "_PER_THREAD", 1)
        _check(vertices, max_leaf)


def _least_cost(bvh, areas, link, parts, known):
    """(least cost of a child as at most `parts` wide subtrees, its number of triangles), by trying all choices."""
    if (link, parts) in known:
        return known[link, parts]
    node, side = link
    child, area = int(bvh.links[node, LINK + side]), areas[node, side]
    if child < 0:
        return (0.0, 0) if child == EMPTY else (area, bvh_leaf(child).count)
    halves = (child, 0), (child, 1)
    count = sum(_least_cost(bvh, areas, half, 1, known)[1] for half in halves)
    least = lambda parts: min(
        sum(_least_cost(bvh, areas, half, k, known)[0] for half, k in zip(halves, (left, parts - left)))
        for left in range(1, parts)
    )
    costs = [area if count <= WIDTH else area + least(WIDTH), *(least(k) for k in range(2, parts + 1))]
    known[link, parts] = min(costs), count
    return known[link, parts]


@pytest.mark.parametrize("builder", ["bsah", "lbvh"])
def test_no_other_choice_of_boxes_costs_less(builder):
    """Costs are compared exactly: corners are small integers."""
    rng = np.random.default_rng(8)
    vertices = (rng.integers(0, 40, (500, 1, 3)) + rng.integers(0, 4, (500, 3, 3))).astype(np.float32)
    bvh = BUILDERS[builder].build(vertices, 1)
    planes = bvh.nodes[:, :12].reshape(-1, 3, 2, 2).astype(float)  # axis, bound, child
    x, y, z = (planes[:, :, 1] - planes[:, :, 0]).transpose(1, 0, 2)
    areas, known = x * (y + z) + y * z, {}
    least = min(
        sum(_least_cost(bvh, areas, (0, side), k, known)[0] for side, k in ((0, left), (1, WIDTH - left)))
        for left in range(1, WIDTH)
    )
    wide = widen(bvh, 1)
    planes = wide.nodes[:, :LINKS].reshape(-1, 3, 2, WIDTH).astype(float)
    x, y, z = (planes[:, :, 1] - planes[:, :, 0]).transpose(1, 0, 2)
    there = wide.links[:, LINKS : LINKS + WIDTH] != NO_CHILD
    assert len(wide.nodes) > 10 and (x * (y + z) + y * z)[there].sum() == least


def test_large_and_shallow():
    vertices = np.ascontiguousarray(HAZARDS["large, terrain"], np.float32)
    assert _check(vertices) < len(vertices) / 20


def test_same_bits_for_any_number_of_threads(monkeypatch):
    monkeypatch.setattr(wide_bvh, "_PER_THREAD", 1)
    bvh = BUILDERS["bsah"].build(np.ascontiguousarray(HAZARDS["large, scattered"], np.float32))
    one = widen(bvh, 1)
    assert len(one.nodes) > 2 * wide_bvh._SUBTREES
    for threads in (2, 3):
        again = widen(bvh, threads)
        assert all(a.tobytes() == b.tobytes() for a, b in zip(one[:4], again[:4]))
