"""Compact trees: block trees without their blocks, as files hold them.

The blocks repeat the corners, lane by lane, and take more than half of a `BlockTree`. Writing them again when a tree is
read takes less time than reading them would. For this, the triangles of a block have consecutive slots, and a link has
the first one in place of the block's number.
"""

from typing import Any, NamedTuple, TypeVar

import numpy as np
from numpy.typing import NDArray

from ..kernels.jit import kernel
from ..kernels.simd import get, ptr, put
from .block_tree import BLOCK, BlockTree, put_triangle
from .nodes import (
    CHILDREN,
    EMPTY,
    LINK,
    MAX_LEAF,
    ROWS,
    Bvh,
    aligned_empty,
    block_leaf,
    block_link,
    box_at,
    bvh_link,
    link_at,
    middle_and_half,
    slot_at,
)

Count = TypeVar("Count", int, NDArray[np.int64])
_BLOCK_BYTES = 4 * (16 * (ROWS + 1) + 8)  # of a block's rows, slots and bounds


class CompactTree(NamedTuple):
    """A `BlockTree` without blocks: a link < 0 is ``block_link(first slot, number of triangles)``."""

    nodes: NDArray[np.float32]  # (m, 16) float32, 64-byte aligned
    links: NDArray[np.int32]  # (m, 16) int32, the same memory
    prim_ids: NDArray[np.int32]  # (n,) int32, as in the `Bvh`
    corners: NDArray[np.float32]  # (n, 9) float32, as in the `Bvh`


def compact(tree: BlockTree) -> CompactTree:
    """The `CompactTree` of a `BlockTree`, with the slots in the order of its blocks."""
    used = tree.slots >= 0
    order, counts = tree.slots[used], used.sum(1)
    nodes = _with_slots(tree, np.cumsum(counts) - counts)
    return CompactTree(nodes, nodes.view(np.int32), tree.prim_ids[order], tree.corners[order])


def compacted(tree: BlockTree) -> CompactTree:
    """The `CompactTree` from which `expand` has made a tree; it shares the triangles."""
    nodes = _with_slots(tree, np.maximum(tree.slots[:, 0], 0))
    return CompactTree(nodes, nodes.view(np.int32), tree.prim_ids, tree.corners)


def _with_slots(tree: BlockTree, first: NDArray[Any]) -> NDArray[np.float32]:
    """A copy of the nodes whose leaves have first slots in place of blocks; first: of each block."""
    nodes = aligned_empty(tree.nodes.shape, "f4")
    nodes[...] = tree.nodes
    node, side, block, size = _leaves(nodes.view(np.int32))
    nodes.view(np.int32)[node, LINK + side] = block_link(first[block], size)
    return nodes


class _Leaves(NamedTuple):
    """The k leaves of a tree."""

    node: NDArray[np.int64]  # (k,)
    side: NDArray[np.int64]  # (k,)
    first: NDArray[np.int32]  # (k,): first slot; of a `BlockTree`, the block
    size: NDArray[np.int32]  # (k,): number of triangles


def _leaves(links: NDArray[np.int32]) -> _Leaves:
    node, side = np.nonzero(links[:, CHILDREN] < 0)
    return _Leaves(node, side, *block_leaf(links[node, LINK + side]))


# --- Expansion to a block tree ----------------------------------------------------------------------------------------


def expanded_bytes(nodes: Count) -> Count:
    """The memory in bytes of the blocks of a tree of `nodes` nodes, or of several."""
    return (nodes + 1) * _BLOCK_BYTES


@kernel
def _expand(nodes, links, corners, blocks, bounds, slots):
    """Write the blocks in the order of the leaves' nodes, and link the leaves to them."""
    # In: nodes, corners. In and out: links, the same memory. Out: blocks, bounds, slots, as in `BlockTree`.
    planes, ends, values, rows, numbers = ptr(nodes), ptr(links), ptr(corners), ptr(blocks), ptr(slots)
    block = 0
    for node in range(len(links)):
        for side in range(2):
            link = get(ends, link_at(node, side))
            if link >= 0:
                continue
            leaf = block_leaf(link)
            for lane in range(16):
                is_used = lane < leaf.count
                slot = np.int64(leaf.block) + (lane if is_used else 0)
                put(numbers, slot_at(block, lane), np.int32(slot) if is_used else np.int32(-1))
                put_triangle(rows, block, lane, values, slot, leaf.count > 0)
            for k in range(4):
                at = box_at(node, side) + 4 * k
                low, high = np.float32(0.0), np.float32(0.0)
                if k < 3 and leaf.count > 0:
                    low, high = get(planes, at), get(planes, at + 2)
                bounds[block, k], bounds[block, 4 + k] = middle_and_half(low, high)
            put(ends, link_at(node, side), np.int32(block_link(block, leaf.count)))
            block += 1


def expand(tree: CompactTree, memory: NDArray[np.uint8]) -> BlockTree:
    """The `BlockTree` of a `CompactTree` without faults, whose links are overwritten.

    memory : (n,) uint8, 64-byte aligned, of at least `expanded_bytes`, for the blocks
    """
    n_blocks = len(tree.nodes) + 1
    ends = np.cumsum([n_blocks * 4 * 16 * ROWS, n_blocks * 4 * 16, n_blocks * 4 * 8])
    blocks, slots, bounds = (memory[end - size : end] for end, size in zip(ends, np.diff(ends, prepend=0)))
    rows = blocks.view(np.float32).reshape(n_blocks, ROWS, 16)
    numbers, boxes = slots.view(np.int32).reshape(n_blocks, 16), bounds.view(np.float32).reshape(n_blocks, 8)
    _expand(tree.nodes, tree.links, tree.corners, rows, boxes, numbers)
    return BlockTree(tree.nodes, tree.links, rows, boxes, numbers, tree.prim_ids, tree.corners)


# --- Conversion to a binary BVH ---------------------------------------------------------------------------------------


def leaf_fault(tree: CompactTree) -> str:
    """The first fault of the leaves of a tree that may have been read from a file; "" if `bvh_of` can convert it."""
    node, side, first, size = _leaves(tree.links)
    if len(node) != len(tree.nodes) + 1:
        return f"it has {len(node)} leaves below {len(tree.nodes)} nodes"
    wrong = (size > BLOCK) | (first + size > len(tree.prim_ids))
    if wrong.any():
        return f"node {node[np.argmax(wrong)]}: a leaf has slots beyond the last, or more than {BLOCK}"
    for i, k in zip(node[size == 0], side[size == 0]):
        if (tree.nodes[i, k:12:2] != tree.nodes[i, 1 - k : 12 : 2]).any():
            return f"node {i}: the box of a missing child is not its sibling's"
    return ""


@kernel
def _bound_halves(corners, first, count, nodes):
    """Write the boxes of both halves of leaves: the first MAX_LEAF triangles, and the others."""
    # In: corners; first, count, (k,) slots of the leaves. Out: nodes, (k, 16)
    for i in range(len(first)):
        middle, end = first[i] + MAX_LEAF, first[i] + count[i]
        for side in range(2):
            for k in range(3):
                low, high = np.float32(np.inf), np.float32(-np.inf)
                for slot in range(middle if side else first[i], end if side else middle):
                    for c in range(k, 9, 3):
                        low, high = min(low, corners[slot, c]), max(high, corners[slot, c])
                nodes[i, 4 * k + side], nodes[i, 4 * k + 2 + side] = low, high


def bvh_of(tree: CompactTree) -> Bvh:
    """The tree as a `Bvh`: leaves of more than `MAX_LEAF` triangles become nodes over both halves of their slots."""
    node, side, first, size = _leaves(tree.links)
    large, m = size > MAX_LEAF, len(tree.nodes)
    nodes = aligned_empty((m + int(large.sum()), 16), "f4")
    nodes[:m], nodes[m:], links = tree.nodes, 0.0, nodes.view(np.int32)
    small = np.where(size > 0, bvh_link(first, size), EMPTY)
    links[node, LINK + side] = np.where(large, m - 1 + np.cumsum(large), small)
    for i, k in zip(node[size == 0], side[size == 0]):
        nodes[i, k:12:4], nodes[i, 2 + k : 12 : 4] = np.inf, -np.inf
    if large.any():
        first, size = first[large], size[large]
        links[m:, LINK], links[m:, LINK + 1] = bvh_link(first, MAX_LEAF), bvh_link(first + MAX_LEAF, size - MAX_LEAF)
        _bound_halves(tree.corners, first, size, nodes[m:])
    return Bvh(nodes, links, tree.prim_ids, tree.corners)
