"""The shape and the memory of trees: subtrees, frequent occluders, and the drawings of Figure 3."""

import numpy as np
import pytest

from antumbra.bvh import binned_sah
from antumbra.bvh.nodes import LEFT_FIRST, ORDER
from antumbra.lab.papers.srdh.srdh_trees import (
    DrawnTree,
    bytes_of,
    frequent_occluders,
    subtrees,
    sums_below,
    tree_memory,
    tree_shape,
    write_trees,
)
from antumbra.trace.rays.ray_hits import Intersections

N = 300


@pytest.fixture(scope="module")
def bvh():
    places = np.random.default_rng(0).uniform(0, 10, (N, 1, 3))
    return binned_sah.build((places + np.eye(3) / 10).astype(np.float32), 1, 1)


def rays_that_meet(prims):
    """A ray per triangle of a list."""
    none, m = np.zeros((len(prims), 3), np.float32), len(prims)
    return Intersections(none, none, np.arange(m + 1), np.array(prims, np.int32))


def test_subtrees_partition_the_triangles(bvh):
    trees = subtrees(bvh)
    m = len(trees.children)
    assert m == N - 1 and trees.parent[0] == -1 and trees.depth[0] == 0
    assert sorted(trees.children.ravel()) == list(range(1, m + N))  # each but the root is a child, once
    assert (trees.depth[1:] == trees.depth[trees.parent[1:]] + 1).all()
    size = sums_below(trees, np.ones(N, np.int64))
    assert size[0] == N and (size[m:] == 1).all() and (size[:m] == size[trees.children].sum(1)).all()


def test_frequent_occluders_make_up_half_of_the_hits():
    frequent = frequent_occluders(rays_that_meet([7] * 5 + [2] * 3 + [4] * 2 + [1] * 2), 9)
    assert np.flatnonzero(frequent).tolist() == [2, 7]  # 5 of 12 are fewer than half
    assert np.flatnonzero(frequent_occluders(rays_that_meet([3, 3, 5]), 9)).tolist() == [3]
    assert not frequent_occluders(rays_that_meet([]), 9).any()


def test_depths_of_frequent_occluders(bvh):
    trees, size = subtrees(bvh), sums_below(subtrees(bvh), np.ones(N, np.int64))
    m = len(trees.children)
    minor = 2 * size < size[trees.parent]  # not half of the parent
    root = int(np.flatnonzero(minor[:m] & (size[:m] > 5) & (trees.depth[:m] == 4))[0])
    below = np.zeros(m + N, bool)
    below[root] = True
    for k in range(m):  # parents of `binned_sah` precede their children
        below[trees.children[k]] |= below[k]
    frequent = np.zeros(N, bool)
    frequent[bvh.prim_ids[below[m:]]] = True
    found = tree_shape("room", "SAH", bvh, frequent)
    assert found[:4] == ("room", "SAH", size[root], 1) and found[4:7] == (4, 4, 4)
    lone = int(np.flatnonzero(~frequent[bvh.prim_ids] & minor[m:] & (trees.depth[m:] > 6))[0])
    frequent[bvh.prim_ids[lone]] = True
    again = tree_shape("room", "SAH", bvh, frequent)
    assert again.roots == 2 and again.first == again.half == 4 and again.frequent == size[root] + 1
    assert tree_shape("room", "SAH", bvh, np.ones(N, bool))[3:7] == (1, 0, 0, 0)


def test_kernels_of_a_tree(bvh):
    links = bvh.links.copy()
    links[:, ORDER] = 0
    links[:7, ORDER] = 1, 1, 2, 3, 1, 2, 0
    shape = tree_shape("room", "srdh", bvh._replace(links=links), np.ones(N, bool))
    assert (shape.ordered, shape.distance) == (6, 3)


def test_memory_of_both_trees(bvh):
    memory = tree_memory("room", bvh, bvh, rays_that_meet([1, 2]))
    assert memory.sah == memory.srdh == bytes_of(bvh) == 64 * (N - 1) + 4 * N + 36 * N
    assert memory.growth == 2.0 and memory.growth_shared == pytest.approx(2 - 36 * N / memory.sah)
    assert memory.rays == 2 * 24 + 3 * 8 + 2 * 4


def test_drawings_of_trees(bvh, tmp_path):
    pytest.importorskip("matplotlib", reason="no matplotlib: the drawings of trees are NOT tested")
    ordered = bvh._replace(links=bvh.links.copy())
    ordered.links[:, ORDER] = LEFT_FIRST
    frequent = np.arange(N) < 20
    trees = [DrawnTree("SAH", bvh), DrawnTree("ordered", ordered)]
    write_trees(trees, frequent, tmp_path / "trees.png")
    from PIL import Image

    pixels = np.asarray(Image.open(tmp_path / "trees.png").convert("RGB")).astype(int)
    red = (pixels[..., 0] > 190) & (pixels[..., 1] < 60)
    half = len(pixels) // 2
    assert red[half:].sum() > 5 * red[:half].sum() > 0  # lines to the first children
