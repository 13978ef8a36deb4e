"""The binary BVH that every builder makes and every tracer walks."""

from typing import NamedTuple

import numpy as np

from ..kernels.jit import inlined, kernel
from ..kernels.simd import ptr, stack_array

MAX_LEAF = 8  # triangles in a leaf, at most
MAX_DEPTH = 64  # inner nodes on any path from the root, at most: the size of a traversal stack
UNORDERED, LEFT_FIRST, FRONT_TO_BACK, BACK_TO_FRONT = range(4)  # which child an any-hit ray visits first
EMPTY = np.int32(-2147483648)  # link of a child that is not there (only under the root of a scene of 0 or 1 triangles)
_WAITING = MAX_DEPTH + 2


class Bvh(NamedTuple):
    """A BVH of ``len(prim_ids)`` triangles; node 0 is the root and always there.

    A node is one 64-byte line that holds the boxes of *both* its children (left L, right R), grouped by axis so that
    one 4-wide register tests a slab of both::

        0..3   x: L.lower  R.lower  L.upper  R.upper
        4..7   y: the same
        8..11  z: the same
        12     link of L (int32 bits)
        13     link of R
        14     which child an any-hit ray visits first, as the builder chose; UNORDERED (0) if it did not
        15     not used (zero)

    A link >= 0 is the index of an inner node. A link < 0 is a leaf: ``~link = first * 8 + count - 1`` where ``first``
    is a slot in ``prim_ids`` and ``corners``. A child that is not there has link ``EMPTY`` and the box
    lower = +inf, upper = -inf, which no ray enters.
    """

    nodes: np.ndarray  # (n_nodes, 16) float32, 64-byte aligned
    links: np.ndarray  # (n_nodes, 16) int32, the same memory
    prim_ids: np.ndarray  # (n,) int32, slot -> triangle index
    corners: np.ndarray  # (n, 9) float32, slot -> the triangle's three vertices (a copy in leaf order)


class Tree(NamedTuple):
    """Pointers to the arrays of a `Bvh`, for hot kernels: passing arrays costs reference counts."""

    nodes: object  # float32 *, 16 a node
    links: object  # int32 *, the same memory
    prim_ids: object  # int32 *
    corners: object  # float32 *, 9 a slot


@inlined
def tree_of(bvh):
    """The pointers of a `Bvh`, which must outlive them."""
    return Tree(ptr(bvh.nodes), ptr(bvh.links), ptr(bvh.prim_ids), ptr(bvh.corners))


@kernel
def _write_parents_first(links, order):
    """Fill the order of `parents_first`; the number of nodes."""
    waiting = stack_array(np.int32, _WAITING)
    waiting[0] = 0
    height, n = 1, 0
    while height > 0:
        height -= 1
        node = waiting[height]
        order[n] = node
        n += 1
        for side in (1, 0):
            if links[node, 12 + side] >= 0:
                waiting[height] = links[node, 12 + side]
                height += 1
    return n


def parents_first(links: np.ndarray) -> np.ndarray:
    """(m,) int32, the inner nodes of a `Bvh`, depth first: parents stand before children, left before right ones."""
    order = np.empty(len(links), np.int32)
    return order[: _write_parents_first(links, order)]


def boxes_of(nodes: np.ndarray) -> np.ndarray:
    """(m, 2, 3) float32: lower and upper corners that hold both children of nodes, (m, 16)."""
    planes = nodes[:, :12].reshape(-1, 3, 2, 2)  # axis, bound, child
    return np.stack([planes[:, :, 0].min(2), planes[:, :, 1].max(2)], 1)


@inlined
def middle_and_half(low, high):
    """(middle, half extent) of an interval of float32, so that middle -+ half holds it."""
    middle = np.float32(0.5) * low + np.float32(0.5) * high
    half = high - middle if high - middle > middle - low else middle - low
    return middle, half * np.float32(1.0 + 2.0**-22)


def aligned_empty(shape: tuple[int, ...], dtype: str) -> np.ndarray:
    """Uninitialised C-contiguous array that starts on a 64-byte line."""
    dt = np.dtype(dtype)
    size = int(np.prod(shape)) * dt.itemsize
    raw = np.empty(size + 64, np.uint8)
    skip = -raw.ctypes.data % 64
    return raw[skip : skip + size].view(dt).reshape(shape)
