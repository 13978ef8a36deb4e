"""The wide BVH is correct: every triangle is in one leaf, and every box bounds everything below it."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from antumbra.bvh import wide_bvh
from antumbra.bvh.nodes import EMPTY, GROUP_WORDS, LINK, LINKS, NO_CHILD, WIDTH, bvh_leaf
from antumbra.bvh.tree_quality import validate
from antumbra.bvh.wide_bvh import widen
from antumbra.bvh.wide_refit import refit_parts, refit_wide
from antumbra.engine.method_registry import BUILDERS
from antumbra.kernels.array_pool import ArrayPool
from bvh_scenes import HAZARDS
from strategies import point_arrays, soups
from strength import examples


def _check(vertices, max_leaf=4, threads=2):
    """Build a tree and check it; return the number of wide nodes."""
    vertices = np.ascontiguousarray(vertices, np.float32)
    bvh = BUILDERS["bsah"].build(vertices, threads, max_leaf)
    return _check_tree(widen(bvh, threads), bvh, vertices)


def _check_tree(wide, bvh, vertices):
    """Walk the tree from the root and check it; return the number of wide nodes."""
    assert wide.bvh is bvh
    assert wide.nodes.ctypes.data % 64 == 0 and wide.groups.ctypes.data % 64 == 0
    assert wide.groups.shape == (len(wide.slots), GROUP_WORDS)
    seen, waiting, nodes = np.zeros(len(vertices), int), [(0, None)], 0
    while waiting:
        node, outer = waiting.pop()
        nodes += 1
        planes, links = wide.nodes[node, :LINKS].reshape(3, 2, WIDTH), wide.links[node, LINKS : LINKS + WIDTH]
        for lane in range(WIDTH):
            box, link = planes[:, :, lane], int(links[lane])
            if link == NO_CHILD:
                assert (box[:, 0] > box[:, 1]).all()
                continue
            if outer is not None:
                assert (box[:, 0] >= outer[:, 0]).all() and (box[:, 1] <= outer[:, 1]).all()
            if link >= 0:
                waiting.append((link, box))
                continue
            group, count = ~link >> 4, ~link & 15
            assert 1 <= count <= WIDTH
            slots = wide.slots[group]
            assert (slots[:count] >= 0).all() and (slots[count:] == -1).all()
            faces = bvh.prim_ids[slots[:count]]
            seen[faces] += 1
            corners = vertices[faces]
            assert (corners >= box[:, 0]).all() and (corners <= box[:, 1]).all()
            edges = np.concatenate([corners[:, 0], corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]], 1)
            rows = wide.groups[group].reshape(10, WIDTH)
            np.testing.assert_array_equal(rows[:9, :count].T, edges)
            np.testing.assert_array_equal(rows[9, :count], np.abs(edges[:, 3:]).max(1))
            assert (rows[:, count:] == 0).all()
    assert (seen == 1).all() and nodes == len(wide.nodes)
    assert wide.reach == tuple(np.abs(vertices).max(axis=(0, 1), initial=np.float32(0.0)))
    return nodes


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


@given(vertices=soups(200), seed=st.integers(0, 99), threads=st.integers(1, 3))
@examples(40)
def test_refitted_to_any_soup(vertices, seed, threads):
    """Moved triangles, some of them without area, in the same nodes and groups."""
    bvh = BUILDERS["bsah"].build(vertices, 2)
    if len(vertices) < 2:
        return
    wide, rng, pool = widen(bvh, 2), np.random.default_rng(seed), ArrayPool()
    parts = refit_parts(wide)
    for _ in range(3):
        moved = vertices[rng.permutation(len(vertices))] * np.float32(rng.uniform(-2, 2))
        moved[rng.random(len(moved)) < 0.1] = moved[0, 0]
        wide = refit_wide(wide, parts, moved, threads, pool)
        validate(wide.bvh, moved)
        _check_tree(wide, wide.bvh, moved)


def test_refitting_to_the_same_triangles_changes_nothing():
    vertices = np.ascontiguousarray(HAZARDS["large, scattered"], np.float32)
    bvh = BUILDERS["bsah"].build(vertices)
    wide = widen(bvh)
    again = refit_wide(wide, refit_parts(wide), vertices, 2, ArrayPool())
    assert all(a.tobytes() == b.tobytes() for a, b in zip(wide[:4], again[:4])) and wide.reach == again.reach


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
