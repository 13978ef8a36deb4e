"""Tree lists: the block trees that the rays of each screen tile traverse one after another.

A tree list holds a scene as a single tree, or as parts; each screen tile lists the parts that it needs, in order (see
`techniques.chcrt`). It addresses its trees by a table of pointers. So trees may share arrays, as subtrees of one
`BlockTree` do, or have their own, as chunks of a scene larger than memory do.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..bvh.block_tree import BlockPointers, BlockTree
from ..kernels.jit import F32Ptr, I32Ptr, I64Ptr, U8Ptr, inlined
from ..kernels.simd import f32_at, get, i32_at, ptr, put
from .descent import NOT_STARTED, Traversal, children, load_saved, save

ADDRESSES = 7  # int64 per tree in the table: addresses of its arrays except links, then the link to its root
CORNERS, ROOT = 5, 6  # columns of the table
TREE = 4  # index of the tree's number in a saved traversal, after the 4 words of `descent.save`
_NO_BOX = np.float32(3.0e38)


class TreeList(NamedTuple):
    """Trees, and lists of them. The owner of the arrays behind the addresses must outlive the tree list."""

    trees: np.ndarray  # (k, ADDRESSES) int64
    heads: np.ndarray  # (k, 16) float32: for each tree, the line of a node whose left child is the tree's root
    tile: int  # width and height of a screen tile in pixels, a multiple of a region's; 0: there is a single tile
    across: int  # tiles per row
    sets: int  # lists per screen tile: one for all strata, or one per stratum of a chunk
    starts: np.ndarray  # (lists + 1,) int32: where in `items` each list begins
    items: np.ndarray  # (m,) int32: numbers of trees
    fresh: bool  # True: no segment has been tested yet; False: the bits mark the segments known to be blocked
    blockers: np.ndarray  # (m,) uint8: set to 1 for the items whose trees block a segment, or are left to exact tests


class TreeListPointers(NamedTuple):
    """Pointers to the arrays of a `TreeList`."""

    trees: I64Ptr  # int64 *
    heads: F32Ptr  # float32 *
    tile: int
    across: int
    sets: int
    starts: I32Ptr  # int32 *
    items: I32Ptr  # int32 *
    fresh: bool
    blockers: U8Ptr  # uint8 *


class Hits(NamedTuple):
    """The nearest hits of a picture's rays so far, (h, w) each. All but `face` and `t` are empty if not needed."""

    face: np.ndarray  # int32: index of the triangle, -1 on a miss
    t: np.ndarray  # float64: in lengths of the direction; inf on a miss
    part: np.ndarray  # int32: number of the tree in the tree list, -1 on a miss
    slot: np.ndarray  # int32: slot in that tree
    signed_t: np.ndarray  # float64, of hits: from `filters.signed_t`; of cameras, only where a tree left memory


def no_hits(shape: tuple[int, int]) -> Hits:
    """`Hits` of rays that all miss so far."""
    face, part, slot = (np.full(shape, -1, np.int32) for _ in range(3))
    return Hits(face, np.full(shape, np.inf), part, slot, np.empty(shape))


@inlined
def tree_list_pointers(tree_list):
    """`TreeListPointers` of a `TreeList`, which must outlive them."""
    return TreeListPointers(
        ptr(tree_list.trees),
        ptr(tree_list.heads),
        np.int64(tree_list.tile),
        np.int64(tree_list.across),
        np.int64(tree_list.sets),
        ptr(tree_list.starts),
        ptr(tree_list.items),
        tree_list.fresh,
        ptr(tree_list.blockers),
    )


@inlined
def _tile_of(tree_list, y, x):
    """The screen tile that contains pixel (y, x)."""
    return y // tree_list.tile * tree_list.across + x // tree_list.tile if tree_list.tile > 0 else 0


@inlined
def list_of(tree_list, y, x, stratum):
    """(begin, end) in `items` of the trees for a stratum of the receivers near pixel (y, x)."""
    number = _tile_of(tree_list, y, x) * tree_list.sets + (stratum if tree_list.sets > 1 else 0)
    return get(tree_list.starts, number), get(tree_list.starts, number + 1)


@inlined
def is_in_memory(tree_list, k):
    """Whether the arrays of tree k are in memory."""
    return get(tree_list.trees, k * ADDRESSES) != 0


@inlined
def tree_in(tree_list, k):
    """The `BlockPointers` of tree k."""
    at = k * ADDRESSES
    nodes = get(tree_list.trees, at)
    return BlockPointers(
        f32_at(nodes),
        i32_at(nodes),
        f32_at(get(tree_list.trees, at + 1)),
        f32_at(get(tree_list.trees, at + 2)),
        i32_at(get(tree_list.trees, at + 3)),
        i32_at(get(tree_list.trees, at + 4)),
        f32_at(get(tree_list.trees, at + 5)),
    )


@inlined
def is_idle(tree_list, y, x):
    """True if no tree is listed for the receivers near pixel (y, x), and their own surfaces have been tested."""
    first = _tile_of(tree_list, y, x) * tree_list.sets
    return not tree_list.fresh and get(tree_list.starts, first) == get(tree_list.starts, first + tree_list.sets)


@inlined
def root_in(tree_list, k):
    """The link to the root of tree k."""
    return get(tree_list.trees, k * ADDRESSES + ROOT)


@inlined
def tree_number(tree_list, i):
    """The number of the tree at place i of the lists."""
    return get(tree_list.items, i)


@inlined
def start_in(tree_list, k, slabs, alive):
    """The initial state of a traversal of tree k by the lanes in `alive` that meet its box; mask 0: none does."""
    return Traversal(root_in(tree_list, k), -1, children(tree_list.heads, k, slabs)[0] & alive, 0)


@inlined
def are_separate(tree_list, j, k):
    """True if trees j and k have separate arrays, so that slots of one are invalid in the other."""
    return get(tree_list.trees, j * ADDRESSES + CORNERS) != get(tree_list.trees, k * ADDRESSES + CORNERS)


# Overloads implement this stub: `_walk_tree` in frusta/bundle.py and `_walk_tree` in packets/packet16.py.
def walk_tree(tree, slabs, at, alive, job, scratch, counters):
    """In kernels: trace the lanes in `alive` through a tree; the type of `job` selects the tracer.

    Return (the `Traversal`, bits of the lanes left, whether a segment was blocked or its test deferred). The place is
    NOT_STARTED once the traversal is complete. It stops early when the memory for deferred tests runs low.
    """


@inlined
def walk_tree_list(tree_list, i, end, slabs, alive, job, scratch, counters):
    """Trace the lanes in `alive` through the trees i .. end of the lists.

    Return (the index in the lists at which to continue, bits of the lanes left). Before it continues, the caller
    settles the deferred tests, because their memory runs low or the next tree has separate arrays.
    """
    at = load_saved(scratch.at, alive)
    while i < end and alive != 0:
        k = tree_number(tree_list, i)
        if get(scratch.deferred, 0) != 0 and are_separate(tree_list, get(scratch.at, TREE), k):
            break
        put(scratch.at, TREE, k)
        if at.place == NOT_STARTED:
            at = start_in(tree_list, k, slabs, alive)
        at, alive, blocks = walk_tree(tree_in(tree_list, k), slabs, at, alive, job, scratch, counters)
        if blocks:
            put(tree_list.blockers, i, 1)
        if at.place != NOT_STARTED:
            break
        i += 1
    save(scratch.at, at)
    return i, alive


def addresses(tree: BlockTree, root: int = 0) -> list[int]:
    """The table row of a `BlockTree`'s subtree below the link `root`."""
    arrays = tree.nodes, tree.blocks, tree.bounds, tree.slots, tree.prim_ids, tree.corners
    return [*(a.ctypes.data for a in arrays), root]


def head(low: ArrayLike, high: ArrayLike) -> NDArray[np.float32]:
    """(..., 16) float32: lines of nodes whose left children have the boxes from `low` to `high`, (..., 3) each."""
    lower, upper = np.asarray(low, np.float32), np.asarray(high, np.float32)
    line = np.zeros((*lower.shape[:-1], 16), np.float32)
    line[..., 0:12:4], line[..., 2:12:4] = lower, upper
    line[..., 1:12:4], line[..., 3:12:4] = lower, upper
    return line


def single_tree(tree: BlockTree, fresh: bool = True) -> TreeList:
    """The `TreeList` of a single tree, for the whole screen; `fresh`: as in `TreeList`."""
    everything = np.full(3, _NO_BOX)
    return TreeList(
        np.array([addresses(tree)], np.int64),
        head([-everything], [everything]),
        0,
        1,
        1,
        np.array([0, 1], np.int32),
        np.zeros(1, np.int32),
        fresh,
        np.zeros(1, np.uint8),
    )
