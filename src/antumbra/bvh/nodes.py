"""Nodes and leaves: the binary BVH that every builder makes, the eight-wide BVH, and the accessors of their links.

Links. In every tree, a link >= 0 is the index of an inner node, and a link < 0 is a leaf. Its contents depend on the
tree:

- `bvh_leaf` of a `Bvh`: first slot and number of triangles, 1 to 8 (not for `EMPTY`)
- `block_leaf` of a `block_tree.BlockTree`: a block and its number of triangles, 0 to 16
- `wide_leaf` of a `WideBvh`: a group and its number of triangles, 0 to 8

All accessors are formulas: kernels inline them, and Python calls them on numbers and arrays. No other module depends on
how links are packed or lines are laid out.

Wide nodes. A node has eight children, and a leaf up to eight triangles. One ray tests eight of either at once.
`wide_bvh.widen` collapses any builder's binary `Bvh` to this form.
"""

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..kernels.array_pool import recycled_empty
from ..kernels.jit import F32Ptr, I32Ptr, formula, inlined, kernel
from ..kernels.simd import get, ptr, put, stack_array, stack_i32

# --- Links and words --------------------------------------------------------------------------------------------------


LINK = 12  # word of the left child's link in a node's line; the right child's link follows
CHILDREN = slice(LINK, LINK + 2)  # words of both links
ORDER = 14  # word of the child order
_LINE = 16  # words per node
_LANES = 16  # triangles per block
ROWS = 9  # rows of 16 float32 per block: v0 (x, y, z), v1 - v0, v2 - v0


class BvhLeaf(NamedTuple):
    """The triangles in a leaf of a `Bvh`."""

    first: int  # slot
    count: int  # type: ignore[assignment]  # hides tuple.count


class BlockLeaf(NamedTuple):
    """A leaf of a `BlockTree`."""

    block: int
    count: int  # type: ignore[assignment]  # hides tuple.count


class WideLeaf(NamedTuple):
    """A leaf of a `WideBvh`."""

    group: int
    count: int  # type: ignore[assignment]  # hides tuple.count


@formula
def is_leaf(link):
    """Whether a link of any tree is a leaf."""
    return link < 0


@formula
def bvh_leaf(link):
    """The leaf of a `Bvh` at a link < 0."""
    return BvhLeaf(~link >> 3, (~link & 7) + 1)


@formula
def bvh_link(first, count):
    """The link to a leaf of a `Bvh`."""
    return ~(first * 8 + count - 1)


@formula
def block_leaf(link):
    """The leaf of a `BlockTree` at a link < 0."""
    return BlockLeaf(~link >> 5, ~link & 31)


@formula
def block_link(block, count):
    """The link to a leaf of a `BlockTree`."""
    return ~(block * 32 + count)


@formula
def wide_leaf(link):
    """The leaf of a `WideBvh` at a link < 0."""
    return WideLeaf(~link >> 4, ~link & 15)


@formula
def wide_link(group, count):
    """The link to a leaf of a `WideBvh`."""
    return ~(group * 16 + count)


# --- words of a binary node's line -------------------------------------------------------------------------------


@formula
def line_at(node):
    """The first word of a node."""
    return node * _LINE


@formula
def box_at(node, side):
    """The first word of a child's box: its lower x. The box's other words follow at offsets 2, 4, 6, 8 and 10."""
    return node * _LINE + side


@formula
def link_at(node, side):
    """The word of the link to a child; `side` is 0 for the left and 1 for the right child."""
    return node * _LINE + LINK + side


@formula
def order_at(node):
    """The word of the child order."""
    return node * _LINE + ORDER


@formula
def sibling_at(word):
    """The word of the sibling's link, for the child whose link is in `word`."""
    return word ^ 1


@formula
def box_of_link_at(word):
    """The first word of the box of the child whose link is in `word`."""
    return (word >> 4) * _LINE + (word & 1)


# --- elements of a block's arrays --------------------------------------------------------------------------------


@formula
def rows_at(block):
    """The first number of a block in `BlockTree.blocks`."""
    return block * (ROWS * _LANES)


@formula
def row_at(block, row):
    """The first number of a row of a block in `BlockTree.blocks`."""
    return (block * ROWS + row) * _LANES


@formula
def slots_at(block):
    """The first slot of a block in `BlockTree.slots`."""
    return block * _LANES


@formula
def slot_at(block, i):
    """The slot of triangle i of a block in `BlockTree.slots`."""
    return block * _LANES + i


@formula
def bounds_at(block):
    """The first number of a block in `BlockTree.bounds`."""
    return block * 8


# --- The binary BVH ---------------------------------------------------------------------------------------------------


MAX_LEAF = 8  # maximum triangles in a leaf
MAX_DEPTH = 64  # maximum inner nodes on a path from the root: the size of a traversal stack
UNORDERED, LEFT_FIRST, FRONT_TO_BACK, BACK_TO_FRONT = range(4)  # child orders for any-hit rays
EMPTY = np.int32(-2147483648)
"""Link of a missing child, as the root of a scene of 0 or 1 triangles has, or a wide node over copies."""
_STACK_SIZE = MAX_DEPTH + 2


class Bvh(NamedTuple):
    """A BVH of ``len(prim_ids)`` triangles. Node 0 is the root and always exists.

    A node is one 64-byte line with the boxes of *both* children (left L, right R), grouped by axis so that one 4-wide
    register tests a slab of both::

        0..3   x: L.lower  R.lower  L.upper  R.upper
        4..7   y: the same
        8..11  z: the same
        12     link of L (int32 bits)
        13     link of R
        14     child order for any-hit rays if the builder has chosen one, else UNORDERED (0)
        15     unused (zero)

    A link >= 0 is the index of an inner node. A link < 0 is a leaf (`bvh_leaf`): a first slot in ``prim_ids`` and
    ``corners``, and a count. A missing child has the link ``EMPTY`` and the box lower = +inf, upper = -inf, which no
    ray enters.
    """

    nodes: NDArray[np.float32]  # (n_nodes, 16) float32, 64-byte aligned
    links: NDArray[np.int32]  # (n_nodes, 16) int32, the same memory
    prim_ids: NDArray[np.int32]  # (n,) int32, slot -> triangle index
    corners: NDArray[np.float32]  # (n, 9) float32, slot -> the triangle's three vertices (a copy in leaf order)


class Tree(NamedTuple):
    """Pointers to the arrays of a `Bvh`, for hot kernels, since passing arrays costs reference counting."""

    nodes: F32Ptr  # float32 *, 16 per node
    links: I32Ptr  # int32 *, the same memory
    prim_ids: I32Ptr  # int32 *
    corners: F32Ptr  # float32 *, 9 per slot


@inlined
def tree_of(bvh):
    """Pointers to the arrays of a `Bvh`, which must outlive them."""
    return Tree(ptr(bvh.nodes), ptr(bvh.links), ptr(bvh.prim_ids), ptr(bvh.corners))


@kernel
def write_parents_first(links, root, order):
    """Fill `order` with the inner nodes from `root` on as `parents_first(links)` does, and return their number."""
    stack = stack_array(np.int32, _STACK_SIZE)
    stack[0] = root
    height, n = 1, 0
    while height > 0:
        height -= 1
        node = stack[height]
        order[n] = node
        n += 1
        for side in (1, 0):
            if links[node, LINK + side] >= 0:
                stack[height] = links[node, LINK + side]
                height += 1
    return n


def parents_first(links: NDArray[np.int32]) -> NDArray[np.int32]:
    """(m,) int32: the inner nodes of a `Bvh`, depth first; parents precede children, and left precedes right."""
    order = np.empty(len(links), np.int32)
    return order[: write_parents_first(links, 0, order)]


def boxes_of(nodes: NDArray[np.float32]) -> NDArray[np.float32]:
    """(m, 2, 3) float32: lower and upper corners of the boxes around both children of `nodes`, (m, 16)."""
    planes = nodes[:, :12].reshape(-1, 3, 2, 2)  # axis, bound, child
    return np.stack([planes[:, :, 0].min(2), planes[:, :, 1].max(2)], 1)


@inlined
def slots_below(link, links, slots):
    """Write the slots below a link to `slots`, an int32 *, left before right, and return their number."""
    stack = stack_i32(_STACK_SIZE)
    put(stack, 0, link)
    height, n = 1, 0
    while height > 0:
        height -= 1
        link = get(stack, height)
        if link == EMPTY:
            continue
        if link >= 0:
            put(stack, height, get(links, link_at(link, 1)))
            put(stack, height + 1, get(links, link_at(link, 0)))
            height += 2
            continue
        leaf = bvh_leaf(link)
        for slot in range(leaf.first, leaf.first + leaf.count):
            put(slots, n, slot)
            n += 1
    return n


@inlined
def sides(nodes, at, other):
    """The side lengths of the hull of two child boxes, whose lower x are the words `at` and `other` of `nodes`."""
    return (
        max(get(nodes, at + 2), get(nodes, other + 2)) - min(get(nodes, at), get(nodes, other)),
        max(get(nodes, at + 6), get(nodes, other + 6)) - min(get(nodes, at + 4), get(nodes, other + 4)),
        max(get(nodes, at + 10), get(nodes, other + 10)) - min(get(nodes, at + 8), get(nodes, other + 8)),
    )


@inlined
def middle_and_half(low, high):
    """(middle, half extent) of a float32 interval, padded so that middle -+ half contains it."""
    middle = np.float32(0.5) * low + np.float32(0.5) * high
    half = high - middle if high - middle > middle - low else middle - low
    return middle, half * np.float32(1.0 + 2.0**-22)


def aligned_empty(shape: tuple[int, ...], dtype: str) -> NDArray[Any]:
    """An uninitialised C-contiguous array, aligned to 64 bytes, in the memory of an earlier one if there is some."""
    return recycled_empty(shape, dtype)


# --- The wide BVH -----------------------------------------------------------------------------------------------------


WIDTH = 8  # children per node
NODE_WORDS = 8 * WIDTH
LINKS = 6 * WIDTH  # word of a node's first link
BINARY = LINKS + WIDTH  # word of its first child in the binary BVH
GROUP_WORDS = 10 * WIDTH
NO_CHILD = np.int32(-1)  # link of a missing child: a leaf without triangles


Reach = tuple[np.float32, np.float32, np.float32]
"""The largest magnitude of a coordinate along each axis."""


class WideBvh(NamedTuple):
    """A wide BVH, and the `Bvh` it was made from. Node 0 is the root and always exists.

    A node is four 64-byte lines: the planes of eight boxes, one 8-wide register each, and the children's links::

        0..7    lower x      8..15   upper x
        16..23  lower y      24..31  upper y
        32..39  lower z      40..47  upper z
        48..55  links (int32 bits)
        56..63  children of the binary BVH with these boxes, for refits: 2 * node + side (int32 bits)

    Children occupy the lanes from 0 on. Any-hit queries visit them from the last to the first, the order of least
    expected cost to block a ray (`child_order.order_wide_children`).

    A link >= 0 is an inner node. A link < 0 is a leaf of 1 to 8 triangles (`wide_leaf`). A missing child has the link
    `NO_CHILD`, which is a leaf without triangles, and a box that no ray enters.

    A group is five lines, or ten 8-wide registers with one triangle per lane: the corner v0 (x, y, z), the edges
    v1 - v0 and v2 - v0, and the largest magnitude of the edges' components. The edges are rounded to float32. Lanes
    from `count` on are zero.
    """

    nodes: NDArray[np.float32]  # (n_nodes, 64) float32, 64-byte aligned
    links: NDArray[np.int32]  # (n_nodes, 64) int32, the same memory
    groups: NDArray[np.float32]  # (n_groups, 80) float32, 64-byte aligned; at least one
    slots: NDArray[np.int32]  # (n_groups, 8) int32: lane -> slot of the binary BVH; -1 in unused lanes
    reach: Reach  # of the root's boxes; 0 without triangles
    bvh: Bvh  # the binary BVH


class WideTree(NamedTuple):
    """Pointers to the arrays of a `WideBvh`, for hot kernels."""

    nodes: F32Ptr  # float32 *, 64 per node
    links: I32Ptr  # int32 *, the same memory
    groups: F32Ptr  # float32 *, 80 per group
    slots: I32Ptr  # int32 *, 8 per group
    prim_ids: I32Ptr  # int32 *, slot -> triangle index
    corners: F32Ptr  # float32 *, 9 per slot
    reach: Reach
    binary: Tree  # of the binary BVH


@inlined
def wide_tree_of(wide):
    """Pointers to the arrays of a `WideBvh`, which must outlive them."""
    return WideTree(
        ptr(wide.nodes),
        ptr(wide.links),
        ptr(wide.groups),
        ptr(wide.slots),
        ptr(wide.bvh.prim_ids),
        ptr(wide.bvh.corners),
        wide.reach,
        tree_of(wide.bvh),
    )
