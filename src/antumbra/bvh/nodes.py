"""The binary BVH that every builder makes and every tracer walks."""

from typing import NamedTuple

import numpy as np

from ..kernels.jit import F32Ptr, I32Ptr, inlined, kernel
from ..kernels.simd import get, ptr, put, stack_array, stack_i32
from .links import LINK, bvh_leaf, link_at

MAX_LEAF = 8  # triangles in a leaf, at most
MAX_DEPTH = 64  # inner nodes on any path from the root, at most: the size of a traversal stack
UNORDERED, LEFT_FIRST, FRONT_TO_BACK, BACK_TO_FRONT = range(4)  # orders of children for any-hit rays
EMPTY = np.int32(-2147483648)  # link of a missing child (only at the root of a scene of 0 or 1 triangles)
_WAITING = MAX_DEPTH + 2


class Bvh(NamedTuple):
    """A BVH of ``len(prim_ids)`` triangles. Node 0 is the root and always exists.

    A node is one 64-byte line with the boxes of *both* its children (left L, right R). They are grouped by axis, so one
    4-wide register tests a slab of both::

        0..3   x: L.lower  R.lower  L.upper  R.upper
        4..7   y: the same
        8..11  z: the same
        12     link of L (int32 bits)
        13     link of R
        14     order of children for any-hit rays, chosen by the builder; else UNORDERED (0)
        15     not used (zero)

    A link >= 0 is the index of an inner node. A link < 0 is a leaf, `links.bvh_leaf`: a first slot in
    ``prim_ids`` and ``corners``, and a count. A missing child has link ``EMPTY`` and the box lower = +inf,
    upper = -inf, which no ray enters.
    """

    nodes: np.ndarray  # (n_nodes, 16) float32, 64-byte aligned
    links: np.ndarray  # (n_nodes, 16) int32, the same memory
    prim_ids: np.ndarray  # (n,) int32, slot -> triangle index
    corners: np.ndarray  # (n, 9) float32, slot -> the triangle's three vertices (a copy in leaf order)


class Tree(NamedTuple):
    """Pointers to the arrays of a `Bvh`, for hot kernels: passing arrays costs reference counts."""

    nodes: F32Ptr  # float32 *, 16 a node
    links: I32Ptr  # int32 *, the same memory
    prim_ids: I32Ptr  # int32 *
    corners: F32Ptr  # float32 *, 9 a slot


@inlined
def tree_of(bvh):
    """Pointers to the arrays of a `Bvh`, which must outlive them."""
    return Tree(ptr(bvh.nodes), ptr(bvh.links), ptr(bvh.prim_ids), ptr(bvh.corners))


@kernel
def _write_parents_first(links, order):
    """Fill the order of `parents_first`, and return the number of nodes."""
    waiting = stack_array(np.int32, _WAITING)
    waiting[0] = 0
    height, n = 1, 0
    while height > 0:
        height -= 1
        node = waiting[height]
        order[n] = node
        n += 1
        for side in (1, 0):
            if links[node, LINK + side] >= 0:
                waiting[height] = links[node, LINK + side]
                height += 1
    return n


def parents_first(links: np.ndarray) -> np.ndarray:
    """(m,) int32: the inner nodes of a `Bvh`, depth first. Parents precede children, and left precedes right."""
    order = np.empty(len(links), np.int32)
    return order[: _write_parents_first(links, order)]


def boxes_of(nodes: np.ndarray) -> np.ndarray:
    """(m, 2, 3) float32: lower and upper corners of boxes around both children of `nodes`, (m, 16)."""
    planes = nodes[:, :12].reshape(-1, 3, 2, 2)  # axis, bound, child
    return np.stack([planes[:, :, 0].min(2), planes[:, :, 1].max(2)], 1)


@inlined
def slots_below(link, links, found):
    """Write the slots below a link to `found`, an int32 *, left before right, and return how many."""
    waiting = stack_i32(_WAITING)
    put(waiting, 0, link)
    height, n = 1, 0
    while height > 0:
        height -= 1
        link = np.int64(get(waiting, height))
        if link == EMPTY:
            continue
        if link >= 0:
            put(waiting, height, get(links, link_at(link, 1)))
            put(waiting, height + 1, get(links, link_at(link, 0)))
            height += 2
            continue
        leaf = bvh_leaf(link)
        for slot in range(leaf.first, leaf.first + leaf.count):
            put(found, n, slot)
            n += 1
    return n


@inlined
def sides(nodes, at, other):
    """The sides of the hull of two child boxes, whose lower x are the words `at` and `other` of `nodes`."""
    return (
        max(get(nodes, at + 2), get(nodes, other + 2)) - min(get(nodes, at), get(nodes, other)),
        max(get(nodes, at + 6), get(nodes, other + 6)) - min(get(nodes, at + 4), get(nodes, other + 4)),
        max(get(nodes, at + 10), get(nodes, other + 10)) - min(get(nodes, at + 8), get(nodes, other + 8)),
    )


@inlined
def middle_and_half(low, high):
    """(middle, half extent) of a float32 interval, padded: middle -+ half contains it."""
    middle = np.float32(0.5) * low + np.float32(0.5) * high
    half = high - middle if high - middle > middle - low else middle - low
    return middle, half * np.float32(1.0 + 2.0**-22)


def aligned_empty(shape: tuple[int, ...], dtype: str) -> np.ndarray:
    """An uninitialised C-contiguous array, aligned to 64 bytes."""
    dt = np.dtype(dtype)
    size = int(np.prod(shape)) * dt.itemsize
    raw = np.empty(size + 64, np.uint8)
    skip = -raw.ctypes.data % 64
    return raw[skip : skip + size].view(dt).reshape(shape)
