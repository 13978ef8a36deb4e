"""The top levels of a build, split by all threads together [Wald 2007], and their assembly with the subtrees below.

The ranges of one level are cut into blocks of a fixed size, which threads bin. The bins of a range's blocks are joined
to choose its split. Then threads move each block's records, in order, to another array, at positions counted
beforehand. The tree does not depend on which thread processes which block.

`assemble` joins the nodes of the top levels and of the subtrees in one array, in depth-first order.
"""

from collections.abc import Callable
from typing import NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray

from ..kernels.jit import kernel
from ..kernels.parallel import items, new_ticket, run_short
from ..kernels.simd import (
    as_i32,
    extract,
    get,
    load8,
    load16,
    minimum,
    ptr,
    ptr_at,
    put,
    select,
    splat8,
    stack_f32,
    stack_i32,
    store,
)
from .binned_split import (
    BIN_BOXES,
    BIN_COUNTS,
    BIN_WORDS,
    Binned,
    Bins,
    cheapest_split,
    clear_bins,
    fill_bins,
    goes_left,
    make_mapping,
    must_halve,
    no_split,
)
from .nodes import CHILDREN, LINK, ORDER, Bvh, aligned_empty, line_at
from .triangle_bounds import INF, double_centroid

# --- Splitting level by level -----------------------------------------------------------------------------------------


BLOCK = 4096  # records
_NO_MEMORY = np.empty(0, np.float32)

SplitLevel: TypeAlias = Callable[
    [NDArray[np.int64], NDArray[np.float32], int], tuple[NDArray[np.int64], NDArray[np.float32]]
]
"""A function that splits the ranges of a level, see `build_top`."""


class Level(NamedTuple):
    """The ranges of records that are split at one level, and their blocks. `last` is one past the end."""

    ranges: NDArray[np.int64]  # (k, 3) int64: first, last, first block
    boxes: NDArray[np.float32]  # (k, 16) float32: box, centroid box
    splits: NDArray[np.int64]  # (k, 3) int64: axis or -1, bin, first record on the right
    blocks: NDArray[np.int64]  # (m, 3) int64: range, first, last
    bins: NDArray[np.float32]  # (m, BIN_WORDS) float32: the bins of each block, counts as int32
    places: NDArray[np.int64]  # (m, 2) int64: new positions of the block's first left and first right record
    sides: NDArray[np.float32]  # (m, 32) float32: box and centroid box of the left records, then of the right


class UpperLevels(NamedTuple):
    """The nodes of the top levels, and the ranges below them that remain to be built."""

    boxes: NDArray[np.float32]  # (t, 2, 8) float32: boxes of both children
    children: NDArray[np.int64]  # (t, 2) int64: index of a node of the top levels, or ~subtree
    ranges: NDArray[np.int64]  # (s, 3) int64: first, last, depth of each subtree
    range_boxes: NDArray[np.float32]  # (s, 16) float32: box, centroid box
    orders: NDArray[np.int32] | None = None  # (t,) int32: child orders, as in `Bvh`; None means UNORDERED


@kernel
def _bins_of_block(level, block):
    """The `Bins` of a block."""
    row = ptr_at(level.bins, block * BIN_WORDS)
    return Bins(row, as_i32(ptr_at(row, BIN_BOXES)))


@kernel
def mapping_of_range(level, r):
    """The `Mapping` of range r."""
    return make_mapping(load8(level.boxes, r * 16 + 8), level.ranges[r, 1] - level.ranges[r, 0])


@kernel
def _bin_blocks(ticket, records, level):
    """Worker: fill the bins of each block."""
    for block in items(ticket):
        r, first, last = level.blocks[block]
        mapping, bins = mapping_of_range(level, r), _bins_of_block(level, block)
        clear_bins(bins, mapping.n_bins)
        fill_bins(records, first, last, mapping, bins)


@kernel
def join_bins(level, first, last, n_bins, total):
    """Join the bins of the blocks from `first` to `last` - 1 in `total`."""
    clear_bins(total, n_bins)
    for block in range(first, last):
        bins = _bins_of_block(level, block)
        for k in range(3 * n_bins):
            store(total.boxes, k * 8, minimum(load8(total.boxes, k * 8), load8(bins.boxes, k * 8)))
            put(total.counts, k, get(total.counts, k) + get(bins.counts, k))


@kernel
def _count_left(level, block, split, n_bins, middle):
    """The number of records in a block that go left."""
    if split.axis < 0:
        return min(max(middle - level.blocks[block, 1], 0), level.blocks[block, 2] - level.blocks[block, 1])
    bins, count = _bins_of_block(level, block), 0
    for k in range(split.axis * n_bins, split.axis * n_bins + split.place):
        count += get(bins.counts, k)
    return count


@kernel
def blocks_of(level, r):
    """(first block, end) of range r."""
    return level.ranges[r, 2], level.ranges[r + 1, 2] if r + 1 < len(level.ranges) else len(level.blocks)


@kernel
def set_split(level, r, split):
    """Store the split of range r, and the new positions of the records in its blocks."""
    n_bins, middle = mapping_of_range(level, r).n_bins, (level.ranges[r, 0] + level.ranges[r, 1]) >> 1
    block, end = blocks_of(level, r)
    next_left = level.ranges[r, 0]
    for b in range(block, end):
        count = _count_left(level, b, split, n_bins, middle)
        level.places[b, 0], level.places[b, 1] = next_left, count
        next_left += count
    next_right = next_left
    for b in range(block, end):
        count = level.blocks[b, 2] - level.blocks[b, 1] - level.places[b, 1]
        level.places[b, 1] = next_right
        next_right += count
    level.splits[r, 0], level.splits[r, 1], level.splits[r, 2] = split.axis, split.place, next_left


@kernel
def _choose_splits(level, depth, scale):
    """Choose the split of each range."""
    total = Bins(stack_f32(BIN_BOXES), stack_i32(BIN_COUNTS))
    for r in range(len(level.ranges)):
        n_bins, split = mapping_of_range(level, r).n_bins, no_split()
        if not must_halve(level.ranges[r, 1] - level.ranges[r, 0], depth):
            block, end = blocks_of(level, r)
            join_bins(level, block, end, n_bins, total)
            split = cheapest_split(total, n_bins, scale)
        set_split(level, r, split)


@kernel
def _move_block(source, target, level, block):
    """Move one block's records, and bound both sides."""
    r, first, last = level.blocks[block]
    axis, bin_, middle = level.splits[r]
    mapping, limit = mapping_of_range(level, r), np.float32(bin_)
    origin, factor = extract(mapping.origin, max(axis, 0)), extract(mapping.factor, max(axis, 0))
    to_left, to_right = level.places[block]
    left_box, left_centroids, right_box, right_centroids = splat8(INF), splat8(INF), splat8(INF), splat8(INF)
    for i in range(first, last):
        is_left = goes_left(source, i, axis, origin, factor, limit) if axis >= 0 else i < middle
        record = load8(source, i * 8)
        centroid, side = double_centroid(record), splat8(is_left)
        left_box = minimum(left_box, select(side, record, INF))
        left_centroids = minimum(left_centroids, select(side, centroid, INF))
        right_box = minimum(right_box, select(side, INF, record))
        right_centroids = minimum(right_centroids, select(side, INF, centroid))
        store(target, (to_left if is_left else to_right) * 8, record)
        to_left += np.int64(is_left)
        to_right += np.int64(not is_left)
    row = block * 32
    store(level.sides, row, left_box)
    store(level.sides, row + 8, left_centroids)
    store(level.sides, row + 16, right_box)
    store(level.sides, row + 24, right_centroids)


@kernel
def _move_blocks(ticket, source, target, level):
    """Worker: move each block's records to their side of the split, and bound both sides."""
    for block in items(ticket):
        _move_block(source, target, level, block)


def _cut_into_blocks(ranges: NDArray[np.int64], boxes: NDArray[np.float32]) -> Level:
    """The `Level` of ranges, (k, 2) first and last record, cut into blocks."""
    counts = -(-(ranges[:, 1] - ranges[:, 0]) // BLOCK)
    start = np.cumsum(counts) - counts
    k, m = len(ranges), int(counts.sum())
    owner = np.repeat(np.arange(k), counts)
    first = ranges[owner, 0] + (np.arange(m) - start[owner]) * BLOCK
    return Level(
        np.column_stack([ranges, start]),
        boxes,
        np.empty((k, 3), np.int64),
        np.column_stack([owner, first, np.minimum(first + BLOCK, ranges[owner, 1])]),
        np.empty((m, BIN_WORDS), np.float32),
        np.empty((m, 2), np.int64),
        np.empty((m, 32), np.float32),
    )


def split_by_bins(method: Binned, scale: np.float32, threads: int) -> SplitLevel:
    """The `split_level` of `build_top` that bins the ranges of a level by all threads together."""

    def split_level(
        ranges: NDArray[np.int64], boxes: NDArray[np.float32], depth: int
    ) -> tuple[NDArray[np.int64], NDArray[np.float32]]:
        return split_blocks(method, ranges, boxes, depth, threads, lambda level: _choose_splits(level, depth, scale))

    return split_level


def split_blocks(
    method: Binned,
    ranges: NDArray[np.int64],
    boxes: NDArray[np.float32],
    depth: int,
    threads: int,
    choose: Callable[[Level], object],
) -> tuple[NDArray[np.int64], NDArray[np.float32]]:
    """Bin the ranges of a level, set their splits by `choose`, and move their records; return as `split_level` does."""
    source, target = (method.spare, method.records) if depth & 1 else (method.records, method.spare)
    level = _cut_into_blocks(ranges, boxes)
    run_short(_bin_blocks, threads, new_ticket(len(level.blocks), 1), source, level)
    choose(level)
    run_short(_move_blocks, threads, new_ticket(len(level.blocks), 1), source, target, level)
    return level.splits[:, 2], np.minimum.reduceat(level.sides, level.ranges[:, 2], axis=0)


def build_top(
    n: int, box: NDArray[np.float32], centroids: NDArray[np.float32], largest: int, split_level: SplitLevel
) -> UpperLevels:
    """Split `n` records until each range has at most `largest`.

    Parameters
    ----------
    box, centroids : (8,) float32
        Box and centroid box of all records.
    split_level : function of (k, 2) ranges, (k, 16) boxes, depth -> (k,) int64, (k, 32) float32
        Splits these ranges. Returns the first right record of each, and the box and centroid box of both sides.
    """
    ranges, boxes = np.array([[0, n]]), np.concatenate([box, centroids])[None]
    depth, n_nodes, n_done = 0, 0, 0
    children, node_boxes, done, done_boxes = [], [np.empty((0, 2, 8), np.float32)], [], []
    while True:
        large = ranges[:, 1] - ranges[:, 0] > largest
        children.append(np.where(large, n_nodes + np.cumsum(large) - 1, ~(n_done + np.cumsum(~large) - 1)))
        k, small = int(np.count_nonzero(large)), int(np.count_nonzero(~large))
        done.append(np.column_stack([ranges[~large], np.full(small, depth)]))
        done_boxes.append(boxes[~large])
        n_nodes, n_done = n_nodes + k, n_done + small
        if k == 0:
            break
        ranges = ranges[large]
        middles, sides = split_level(ranges, boxes[large], depth)
        node_boxes.append(sides.reshape(k, 4, 8)[:, ::2])
        ranges = np.column_stack([ranges[:, 0], middles, middles, ranges[:, 1]]).reshape(2 * k, 2)
        boxes, depth = sides.reshape(2 * k, 16), depth + 1
    return UpperLevels(
        np.concatenate(node_boxes),
        np.concatenate(children)[1:].reshape(-1, 2),
        np.concatenate(done),
        np.concatenate(done_boxes),
    )


# --- Assembly ---------------------------------------------------------------------------------------------------------


class Subtrees(NamedTuple):
    """The subtrees that threads have built below the top levels."""

    nodes: NDArray[
        np.float32
    ]  # (m, 16) float32: subtree by subtree, depth first; links number a subtree's nodes from 1
    shares: NDArray[np.int64]  # (s, 3) int64: first node, number of nodes (0 for a leaf), link to it, of each subtree


@kernel
def _place(children, counts, node_at, subtree_at, stack):
    """`place`; `stack` is scratch memory for one more link than the top levels have nodes."""
    stack[0] = 0 if len(children) else -1
    height, position = 1, 0
    while height > 0:
        height -= 1
        child = stack[height]
        if child < 0:
            subtree_at[~child] = position
            position += counts[~child]
            continue
        node_at[child] = position
        position += 1
        stack[height], stack[height + 1] = children[child, 1], children[child, 0]
        height += 2
    return position


def place(
    children: NDArray[np.int64], counts: NDArray[np.int64], node_at: NDArray[np.int64], subtree_at: NDArray[np.int64]
) -> int:
    """Number all nodes in depth-first order, and return their total number.

    children : links of the top levels, as in `UpperLevels`
    counts : (s,) nodes of each subtree
    node_at, subtree_at : output; the index of each node of the top levels, and of each subtree's first node
    """
    return int(_place(children, counts, node_at, subtree_at, np.empty(len(children) + 1, np.int64)))


@kernel
def join_boxes(children, roots, boxes):
    """Compute the child boxes of the top levels from the boxes of the subtrees' roots.

    children : as in `UpperLevels`, parents first
    roots : (s, 8) float32
    boxes : (t, 2, 8) float32, output
    """
    for t in range(len(children) - 1, -1, -1):
        for side in range(2):
            child = children[t, side]
            if child < 0:
                box = load8(roots, ~child * 8)
            else:
                box = minimum(load8(boxes, child * 16), load8(boxes, child * 16 + 8))
            store(boxes, (t * 2 + side) * 8, box)


@kernel
def _copy_subtrees(ticket, subtrees, subtree_at, nodes, links):
    """Worker: copy each subtree's nodes to their place, and shift their links."""
    source, target = ptr(subtrees.nodes), ptr(nodes)
    for s in items(ticket):
        first, count, at = subtrees.shares[s, 0], subtrees.shares[s, 1], subtree_at[s]
        for i in range(count):
            store(target, line_at(at + i), load16(source, line_at(first + i)))
            for side in range(2):
                if links[at + i, LINK + side] >= 0:
                    links[at + i, LINK + side] += at - 1


def top_lines(top: UpperLevels, node_at: NDArray[np.int64], subtree_links: NDArray[np.int64]) -> NDArray[np.float32]:
    """(t, 16) float32: the nodes of the top levels."""
    t = len(top.children)
    lines = np.zeros((t, 16), np.float32)
    corners = np.concatenate([top.boxes[:, :, 0:3], -top.boxes[:, :, 4:7]], axis=1)
    lines[:, :12] = corners.transpose(0, 2, 1).reshape(t, 12)
    is_node = top.children >= 0
    links = np.empty((t, 2), np.int64)
    links[is_node] = node_at[top.children[is_node]]
    links[~is_node] = subtree_links[~top.children[~is_node]]
    lines.view(np.int32)[:, CHILDREN] = links
    if top.orders is not None:
        lines.view(np.int32)[:, ORDER] = top.orders
    return lines


def _nodes_in(memory: NDArray[np.float32], count: int) -> NDArray[np.float32]:
    """(count, 16) float32: in `memory` if they fit and fill most of it, otherwise in their own memory."""
    words = 16 * count
    if 3 * memory.size > 4 * words or memory.size < words:
        return aligned_empty((count, 16), "f4")
    return memory.reshape(-1)[:words].reshape(count, 16)


def assemble(
    bvh: Bvh, top: UpperLevels, subtrees: Subtrees, threads: int, memory: NDArray[np.float32] = _NO_MEMORY
) -> Bvh:
    """`bvh` with all its nodes, aligned to 64 bytes. Every left child follows its parent in memory.

    memory : an aligned array that is no longer needed; fresh memory for the nodes of a large scene costs 3 % of a build
    """
    node_at, subtree_at = np.empty(len(top.children), np.int64), np.empty(len(subtrees.shares), np.int64)
    count = place(top.children, subtrees.shares[:, 1], node_at, subtree_at)
    nodes = _nodes_in(memory, count)
    ticket = new_ticket(len(subtree_at), 1)
    run_short(_copy_subtrees, threads, ticket, subtrees, subtree_at, nodes, nodes.view(np.int32))
    links = np.where(subtrees.shares[:, 2] >= 0, subtree_at, subtrees.shares[:, 2])
    nodes[node_at] = top_lines(top, node_at, links)
    return bvh._replace(nodes=nodes, links=nodes.view(np.int32))
