"""A shallower BVH for ray bundles: small subtrees become blocks of up to 16 triangles, one per lane.

Frusta cannot separate the boxes deep in a tree, so a shallower tree is faster [Benthin and Wald 2009, Sec. 5]. Every
subtree of at most `BLOCK` triangles becomes one leaf with one triangle per lane. Culling a whole block then costs as
much as culling one triangle against 16 frusta.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..kernels.jit import F32Ptr, I32Ptr, inlined, kernel
from ..kernels.parallel import items, new_ticket, run_short, thread_count
from ..kernels.simd import get, load16, ptr, put, stack_array, stack_i32, store
from .child_order import order_for_bundles, triangle_area
from .nodes import (
    EMPTY,
    LINK,
    MAX_DEPTH,
    ROWS,
    Bvh,
    aligned_empty,
    block_link,
    bvh_leaf,
    line_at,
    link_at,
    middle_and_half,
    parents_first,
    row_at,
    slot_at,
    slots_below,
)

BLOCK = 16  # maximum triangles in a block
_STACK_SIZE = 2 * MAX_DEPTH


class BlockTree(NamedTuple):
    """A binary tree over blocks of triangles.

    Nodes are as in `Bvh`, but a link < 0 is a block of 0 to 16 triangles (`nodes.block_leaf`). A missing child is a
    block of 0 triangles with its sibling's box (zeros if both are missing). The left child is the one that blocks more
    rays for its cost (`child_order`).
    """

    nodes: NDArray[np.float32]  # (m, 16) float32, 64-byte aligned
    links: NDArray[np.int32]  # (m, 16) int32, the same memory
    blocks: NDArray[
        np.float32
    ]  # (b, 9, 16) float32: v0, v1 - v0, v2 - v0, rounded once; unused lanes repeat the first triangle
    bounds: NDArray[
        np.float32
    ]  # (b, 8) float32: centre and half extents of each block's box: x, y, z and an unused word each
    slots: NDArray[np.int32]  # (b, 16) int32: slot in `corners` and `prim_ids`; -1 in unused lanes
    prim_ids: NDArray[np.int32]  # (n,) int32, as in the `Bvh`
    corners: NDArray[np.float32]  # (n, 9) float32, as in the `Bvh`


class BlockPointers(NamedTuple):
    """Pointers to the arrays of a `BlockTree`, which must outlive them."""

    nodes: F32Ptr  # float32 *, 16 per node
    links: I32Ptr  # int32 *, the same memory
    blocks: F32Ptr  # float32 *, 144 per block
    bounds: F32Ptr  # float32 *, 8 per block
    slots: I32Ptr  # int32 *, 16 per block
    prim_ids: I32Ptr  # int32 *
    corners: F32Ptr  # float32 *, 9 per slot


@inlined
def block_pointers(tree):
    """`BlockPointers` of a `BlockTree`."""
    return BlockPointers(
        ptr(tree.nodes),
        ptr(tree.links),
        ptr(tree.blocks),
        ptr(tree.bounds),
        ptr(tree.slots),
        ptr(tree.prim_ids),
        ptr(tree.corners),
    )


@inlined
def _size(link, below):
    """The number of triangles below a link."""
    if link == EMPTY:
        return 0
    return np.int64(below[link]) if link >= 0 else np.int64(bvh_leaf(link).count)


@kernel
def _count_below(links, order, below):
    """Count the triangles below each inner node; `order` has parents first."""
    for i in range(len(order) - 1, -1, -1):
        node = order[i]
        below[node] = _size(links[node, LINK], below) + _size(links[node, LINK + 1], below)


@kernel
def _repair_empty(nodes, node, left_link, right_link):
    """Give a missing child its sibling's box, so that no box is infinite."""
    for axis in range(0, 12, 4):
        for k in (0, 2):
            if left_link == EMPTY:
                nodes[node, axis + k] = np.float32(0.0) if right_link == EMPTY else nodes[node, axis + k + 1]
            if right_link == EMPTY:
                nodes[node, axis + k + 1] = nodes[node, axis + k]


@kernel
def _collapse(source, source_links, below, block, nodes, links, roots):
    """Copy the nodes above the blocks, depth first, and return (number of nodes, number of blocks)."""
    # In: source, source_links, of the `Bvh`; below, triangle count of each node; block, maximum triangles in a block
    # Out: nodes, links, of the `BlockTree`; roots, (n_blocks,) int32 source link of each block
    stack = stack_array(np.int64, _STACK_SIZE, 2)  # source node; word of `links` that takes its new index, or -1
    stack[0, 0], stack[0, 1] = 0, -1
    height, n, n_blocks = 1, 0, 0
    while height > 0:
        height -= 1
        old, word = stack[height]
        store(nodes, line_at(n), load16(source, line_at(old)))
        if word >= 0:
            put(links, word, n)
        for child in (1, 0):
            link = np.int64(source_links[old, LINK + child])
            count = _size(link, below)
            if link >= 0 and count > block:
                stack[height, 0], stack[height, 1] = link, link_at(n, child)
                height += 1
            else:
                links[n, LINK + child] = block_link(n_blocks, count)
                roots[n_blocks] = link
                n_blocks += 1
        _repair_empty(nodes, n, source_links[old, LINK], source_links[old, LINK + 1])
        n += 1
    return n, n_blocks


@inlined
def _bound_block(corners, block_slots, n, bounds, block):
    """Write the centre and half extents of a block's box, rounded outwards."""
    for k in range(3):
        low, high = np.float32(np.inf), np.float32(-np.inf)
        for i in range(n):
            slot = get(block_slots, i) * 9
            for corner in (0, 3, 6):
                x = get(corners, slot + corner + k)
                low, high = x if x < low else low, x if x > high else high
        if n == 0:
            low, high = np.float32(0.0), np.float32(0.0)
        bounds[block, k], bounds[block, 4 + k] = middle_and_half(low, high)


@inlined
def put_triangle(rows, block, lane, corners, slot, exists):
    """Write the triangle in a slot to a lane of a block, or zeros."""
    at = np.int64(slot) * 9
    for k in range(3):
        v0 = get(corners, at + k) if exists else np.float32(0.0)
        v1 = get(corners, at + 3 + k) if exists else np.float32(0.0)
        v2 = get(corners, at + 6 + k) if exists else np.float32(0.0)
        put(rows, row_at(block, k) + lane, v0)
        put(rows, row_at(block, 3 + k) + lane, v1 - v0)
        put(rows, row_at(block, 6 + k) + lane, v2 - v0)


@kernel
def _fill_blocks(ticket, source_links, corners, roots, blocks, bounds, slots, areas):
    """Worker: write the rows, the bounds and the triangles' total area of each block."""
    # In: source_links, corners, of the `Bvh`; roots, (b,) source link of each block
    # Out: blocks, bounds, slots, as in `BlockTree`; areas, (b,) float64, zero on entry
    links, values, rows, block_slots = ptr(source_links), ptr(corners), ptr(blocks), stack_i32(64)
    for block in items(ticket):
        n = slots_below(roots[block], links, block_slots)
        _bound_block(values, block_slots, n, bounds, block)
        for i in range(n):
            areas[block] += triangle_area(values, get(block_slots, i))
        for lane in range(16):
            is_used = lane < n
            slot = get(block_slots, lane if is_used else 0) if n > 0 else np.int32(0)
            put(ptr(slots), slot_at(block, lane), slot if is_used else np.int32(-1))
            put_triangle(rows, block, lane, values, slot, n > 0)


def block_tree(bvh: Bvh, threads: int | None = None, block: int = BLOCK) -> BlockTree:
    """The `BlockTree` of a `Bvh`: leaves and subtrees of at most `block` (1 to 16) triangles become blocks."""
    count = len(bvh.nodes)
    below = np.empty(count, np.int32)
    _count_below(bvh.links, parents_first(bvh.links), below)
    nodes, roots = aligned_empty((count, 16), "f4"), np.empty(count + 1, np.int32)
    n, n_blocks = _collapse(bvh.nodes, bvh.links, below, block, nodes, nodes.view(np.int32), roots)
    nodes = nodes[:n]
    blocks, slots = aligned_empty((n_blocks, ROWS, 16), "f4"), np.empty((n_blocks, 16), np.int32)
    bounds, areas = np.zeros((n_blocks, 8), np.float32), np.zeros(n_blocks)
    run_short(
        _fill_blocks,
        thread_count(threads),
        new_ticket(n_blocks, 256),
        bvh.links,
        bvh.corners,
        roots[:n_blocks],
        blocks,
        bounds,
        slots,
        areas,
    )
    order_for_bundles(nodes, nodes.view(np.int32), areas)
    return BlockTree(nodes, nodes.view(np.int32), blocks, bounds, slots, bvh.prim_ids, bvh.corners)
