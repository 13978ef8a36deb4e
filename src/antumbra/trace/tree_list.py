"""Tree lists: the trees of blocks that the rays of each screen tile traverse one after another.

It holds a whole scene as one tree, or the parts of a scene that each screen tile needs. A *tree list* starts with a
table of addresses, so its trees may share arrays or have their own. Subtrees of one `BlockTree` share arrays. Chunks of
a scene that is larger than memory have their own. The lists give the trees of each screen tile in order; see `chcrt`.
"""

from typing import NamedTuple

import numpy as np

from ..bvh.block_tree import BlockPointers, BlockTree
from ..kernels.jit import F32Ptr, I32Ptr, I64Ptr, inlined
from ..kernels.simd import f32_at, get, i32_at, ptr, put
from .descent import NOWHERE, At, children, save, saved

ADDRESSES = 7  # int64 of a tree in the table: the addresses of its arrays except links, then the link to its root
CORNERS, ROOT = 5, 6  # places in a row of the table
TREE = 4  # in a saved walk, the place of the tree's number; `descent.save` writes the 4 words before it
_NO_BOX = np.float32(3.0e38)


class TreeList(NamedTuple):
    """Trees, and lists of them. The owner of the memory behind the addresses must outlive the forest."""

    trees: np.ndarray  # (k, ADDRESSES) int64
    heads: np.ndarray  # (k, 16) float32: for each tree, the line of a node whose left child is the tree's root
    tile: int  # width and height of a screen tile in pixels, a multiple of a region's; 0: there is one tile
    across: int  # tiles in a row
    sets: int  # lists of a screen tile: one for all strata, or one for each stratum of a chunk
    starts: np.ndarray  # (lists + 1,) int32: where in `items` each list begins
    items: np.ndarray  # (m,) int32: numbers of trees
    fresh: bool  # True: nothing is known of the segments yet; False: the bits tell which ones are blocked


class TreeListPointers(NamedTuple):
    """Pointers to the arrays of a `Forest`."""

    trees: I64Ptr  # int64 *
    heads: F32Ptr  # float32 *
    tile: int
    across: int
    sets: int
    starts: I32Ptr  # int32 *
    items: I32Ptr  # int32 *
    fresh: bool


class Hits(NamedTuple):
    """The nearest hits of a picture's rays so far, (h, w) each. `part` and `slot` are empty if they are not needed."""

    face: np.ndarray  # int32: index of the triangle, -1 on a miss
    t: np.ndarray  # float64: in lengths of the direction; inf on a miss
    part: np.ndarray  # int32: number of the tree in the forest, -1 on a miss
    slot: np.ndarray  # int32: in that tree


def no_hits(shape: tuple[int, int]) -> Hits:
    """`Hits` in which every ray has missed so far."""
    face, part, slot = (np.full(shape, -1, np.int32) for _ in range(3))
    return Hits(face, np.full(shape, np.inf), part, slot)


@inlined
def tree_list_pointers(forest):
    """`ForestPointers` of a `Forest`, which must outlive them."""
    return TreeListPointers(
        ptr(forest.trees), ptr(forest.heads), np.int64(forest.tile), np.int64(forest.across), np.int64(forest.sets),
        ptr(forest.starts), ptr(forest.items), forest.fresh,
    )  # fmt: skip


@inlined
def _tile_of(forest, y, x):
    """The screen tile that pixel (y, x) is in."""
    return y // forest.tile * forest.across + x // forest.tile if forest.tile > 0 else np.int64(0)


@inlined
def list_of(forest, y, x, stratum):
    """(begin, end) in `items` of the trees for a stratum of the receivers near pixel (y, x)."""
    number = _tile_of(forest, y, x) * forest.sets + (stratum if forest.sets > 1 else np.int64(0))
    return np.int64(get(forest.starts, number)), np.int64(get(forest.starts, number + 1))


@inlined
def tree_in(forest, k):
    """The `BlockPointers` of tree k."""
    at = k * ADDRESSES
    nodes = np.int64(get(forest.trees, at))
    return BlockPointers(
        f32_at(nodes), i32_at(nodes), f32_at(get(forest.trees, at + 1)), f32_at(get(forest.trees, at + 2)),
        i32_at(get(forest.trees, at + 3)), i32_at(get(forest.trees, at + 4)), f32_at(get(forest.trees, at + 5)),
    )  # fmt: skip


@inlined
def is_idle(forest, y, x):
    """Is the list of the receivers near pixel (y, x) empty, and are their own surfaces already applied?"""
    first = _tile_of(forest, y, x) * forest.sets
    return not forest.fresh and get(forest.starts, first) == get(forest.starts, first + forest.sets)


@inlined
def root_in(forest, k):
    """The link to the root of tree k."""
    return np.int64(get(forest.trees, k * ADDRESSES + ROOT))


@inlined
def item(forest, i):
    """The number of the tree at place i of the lists."""
    return np.int64(get(forest.items, i))


@inlined
def start_in(forest, k, slabs, alive):
    """The start of a walk through tree k, with the lanes in `alive` that meet its box; mask 0: no lane does."""
    return At(root_in(forest, k), np.int64(-1), children(forest.heads, k, slabs)[0] & alive, np.int64(0))


@inlined
def are_separate(forest, j, k):
    """Have trees j and k separate arrays? Then slots of one mean nothing in the other."""
    return get(forest.trees, j * ADDRESSES + CORNERS) != get(forest.trees, k * ADDRESSES + CORNERS)


# Overloads give the bodies of this stub: `_walk_tree` in multifrusta/walk.py and `_walk_tree` in packets/packet16.py.
def walk_tree(tree, slabs, at, alive, job, scratch, counters):
    """In kernels: trace the lanes in `alive` through a tree, as the type of `job` says.

    Return (the `At` of the walk, bits of the lanes left). The place is NOWHERE if the walk is over. A walk stops early
    when the memory for deferred tests runs low.
    """


@inlined
def walk_tree_list(forest, i, end, slabs, alive, job, scratch, counters):
    """Trace the lanes in `alive` through the trees i .. end of the lists.

    Return (the place in the lists to go on with, bits of the lanes left). If the walk is not over, the caller settles
    the deferred tests first: their memory runs low, or the next tree has separate arrays.
    """
    at = saved(scratch.at, alive)
    while i < end and alive != 0:
        k = item(forest, i)
        if np.int64(get(scratch.deferred, 0)) != 0 and are_separate(forest, np.int64(get(scratch.at, TREE)), k):
            break
        put(scratch.at, TREE, k)
        if at.place == NOWHERE:
            at = start_in(forest, k, slabs, alive)
        at, alive = walk_tree(tree_in(forest, k), slabs, at, alive, job, scratch, counters)
        if at.place != NOWHERE:
            break
        i += 1
    save(scratch.at, at)
    return i, alive


def addresses(tree: BlockTree, root: int = 0) -> list[int]:
    """A row of the table for the subtree of a `BlockTree` below the link `root`."""
    arrays = tree.nodes, tree.blocks, tree.bounds, tree.slots, tree.prim_ids, tree.corners
    return [*(a.ctypes.data for a in arrays), root]


def head(low, high) -> np.ndarray:
    """(..., 16) float32: the lines of nodes whose left children have the boxes from `low` to `high`, (..., 3)."""
    low, high = np.asarray(low, np.float32), np.asarray(high, np.float32)
    line = np.zeros((*low.shape[:-1], 16), np.float32)
    line[..., 0:12:4], line[..., 2:12:4] = low, high
    line[..., 1:12:4], line[..., 3:12:4] = low, high
    return line


def whole(tree: BlockTree) -> TreeList:
    """A `Forest` of one whole tree, for the whole screen."""
    everything = np.full(3, _NO_BOX)
    return TreeList(
        np.array([addresses(tree)], np.int64), head([-everything], [everything]), 0, 1, 1,
        np.array([0, 1], np.int32), np.zeros(1, np.int32), True,
    )  # fmt: skip
