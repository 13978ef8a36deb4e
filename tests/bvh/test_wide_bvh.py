"""The wide BVH is correct: every triangle is in one leaf, and every box bounds everything below it."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from antumbra.bvh.nodes import GROUP_WORDS, LINKS, NO_CHILD, WIDTH
from antumbra.bvh.refit import refit_faces
from antumbra.bvh.tree_quality import validate
from antumbra.bvh.wide_bvh import refit_wide, widen
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


@given(vertices=soups(200) | point_arrays((30, 3)) | point_arrays((3, 3)), max_leaf=st.integers(1, 8))
@examples(40)
def test_any_soup_and_leaf_size(vertices, max_leaf):
    _check(vertices, max_leaf)


@given(vertices=soups(200), seed=st.integers(0, 99), threads=st.integers(1, 3))
@examples(40)
def test_refitted_to_any_soup(vertices, seed, threads):
    """Moved triangles, some of them without area, in the same nodes and groups."""
    bvh = BUILDERS["bsah"].build(vertices, 2)
    if len(vertices) < 2:
        return
    wide, rng, pool = widen(bvh, 2), np.random.default_rng(seed), ArrayPool()
    for _ in range(3):
        moved = vertices[rng.permutation(len(vertices))] * np.float32(rng.uniform(-2, 2))
        moved[rng.random(len(moved)) < 0.1] = moved[0, 0]
        bvh = refit_faces(bvh, moved, threads, pool)
        validate(bvh, moved)
        wide = refit_wide(wide, bvh, threads, pool)
        _check_tree(wide, bvh, moved)


def test_refitting_to_the_same_triangles_changes_nothing():
    vertices = np.ascontiguousarray(HAZARDS["large, scattered"], np.float32)
    bvh = BUILDERS["bsah"].build(vertices)
    wide = widen(bvh)
    again = refit_wide(wide, refit_faces(bvh, vertices, 2, ArrayPool()), 2, ArrayPool())
    assert all(a.tobytes() == b.tobytes() for a, b in zip(wide[:4], again[:4])) and wide.reach == again.reach


def test_large_and_shallow():
    vertices = np.ascontiguousarray(HAZARDS["large, terrain"], np.float32)
    assert _check(vertices) < len(vertices) / 20


def test_same_bits_for_any_number_of_threads():
    bvh = BUILDERS["bsah"].build(np.ascontiguousarray(HAZARDS["large, scattered"], np.float32))
    one = widen(bvh, 1)
    for threads in (2, 3):
        again = widen(bvh, threads)
        assert all(a.tobytes() == b.tobytes() for a, b in zip(one[:4], again[:4]))
