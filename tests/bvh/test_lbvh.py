"""Promises of `lbvh` beyond those of all builders: it is the tree of the Morton codes."""

import numpy as np
import pytest

from antumbra.bvh import lbvh
from antumbra.bvh.nodes import MAX_DEPTH
from antumbra.bvh.tree_quality import statistics, validate
from bvh_scenes import LARGE, integer_grid, scattered, terrain
from reference_morton import depth_of, karras_tree, morton_codes

BUILD = {10: lbvh.build, 21: lbvh.build63}
SCENES = {
    "two": scattered(2),
    "three": scattered(3),
    "opposite corners": np.repeat(np.array([[[0, 0, 0]], [[8, 8, 8]], [[8, 8, 8]]], np.float32), 3, axis=1),
    "scattered": scattered(700),
    "terrain": terrain(900),
    "grid": integer_grid(512),
    "ties": np.tile(scattered(9), (41, 1, 1)),
    "all equal": np.tile(scattered(1), (77, 1, 1)),
    "in two spots": np.concatenate([scattered(200) * np.float32(1e-4), scattered(200) + np.float32(50)]),
}


@pytest.fixture(autouse=True)
def threads_for_small_scenes(monkeypatch):
    monkeypatch.setattr(lbvh, "_PER_THREAD", 1000)


def tree_of(bvh, link=0):
    """The tree in the form of `karras_tree`."""
    if link < 0:
        return ~link >> 3, (~link & 7) + 1
    return [tree_of(bvh, int(child)) for child in bvh.links[link, 12:14]]


@pytest.mark.parametrize("max_leaf", [1, 3, 4, 8])
@pytest.mark.parametrize("bits", BUILD)
@pytest.mark.parametrize("name", SCENES)
def test_tree_is_that_of_the_codes(name, bits, max_leaf):
    vertices = SCENES[name]
    bvh = BUILD[bits](vertices, 1, max_leaf)
    order, tree = karras_tree(morton_codes(vertices, bits), max_leaf)
    assert bvh.prim_ids.tolist() == order
    assert tree_of(bvh) == tree


def test_tree_that_many_threads_make_is_that_of_the_codes():
    vertices = terrain(LARGE)
    order, tree = karras_tree(morton_codes(vertices, 10), 4)
    bvh = lbvh.build(vertices, 3)
    assert bvh.prim_ids.tolist() == order and tree_of(bvh) == tree


def test_small_scenes_are_built_by_fewer_threads(monkeypatch):
    used, vertices = [], terrain(LARGE)
    sort = lbvh.sort_by_codes
    monkeypatch.setattr(
        lbvh, "sort_by_codes", lambda flat, bits, threads: used.append(threads) or sort(flat, bits, threads)
    )
    for per_thread in (len(vertices) // 2, len(vertices) + 1):
        monkeypatch.setattr(lbvh, "_PER_THREAD", per_thread)
        lbvh.build(vertices, 8)
    assert used == [3, 1]


def test_left_child_comes_right_behind_its_parent():
    for vertices in (terrain(3000), terrain(LARGE)):
        left = lbvh.build(vertices).links[:, 12]
        inner = np.flatnonzero(left >= 0)
        assert len(inner) > 100 and np.array_equal(left[inner], inner + 1)


@pytest.mark.parametrize("copies", [2, 3, 1000, 3 * LARGE])
def test_tree_that_all_bits_would_make_too_deep(copies):
    """Points at 2 ** -k on each axis differ at each bit of a code. Below that, slots separate the copies at 0."""
    powers = np.concatenate([2.0**-k * np.eye(3) for k in range(22)])
    points = np.concatenate([powers, np.zeros((copies, 3))]).astype(np.float32)
    vertices = np.repeat(points[:, None], 3, axis=1)
    depth = depth_of(karras_tree(morton_codes(vertices, 21))[1])
    for threads in (1, 3):
        bvh = lbvh.build63(vertices, threads, 1)
        validate(bvh, vertices)
        assert statistics(bvh).depth <= MAX_DEPTH
        if depth <= MAX_DEPTH:
            assert statistics(bvh).depth == depth
    assert depth == 63 + (copies - 1).bit_length()
