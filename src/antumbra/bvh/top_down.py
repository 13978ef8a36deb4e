"""The common part of top-down builders: subtrees that one thread each builds depth first, in place.

All threads split the top levels together (`top_levels`). Then each thread builds ranges alone, the largest first, and
`top_levels.assemble` puts all nodes into one array. The builder's method splits ranges (`binned_split`).

Optimal subtrees. Most of a tree's nodes have at most four triangles below them, where binning is slow and finds little.
For up to four records, the tree of minimum SAH cost among all trees is found instead. There are at most 11 subsets of
two or more records, and the optimal tree over each follows from those over smaller subsets [Karras and Aila 2013, "Fast
parallel construction of high-quality bounding volume hierarchies"].
"""

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..kernels.jit import F32Ptr, I32Ptr, inlined, kernel, overload, overloaded
from ..kernels.parallel import items, new_ticket, run_short
from ..kernels.simd import (
    as_i32,
    atomic_add,
    get,
    load8,
    load16,
    lowest_bit,
    minimum,
    popcount,
    prefetch,
    ptr,
    ptr_at,
    put,
    stack_f32,
    stack_i32,
    store,
)
from .binned_split import divide, find_split, source_of
from .nodes import LINK, MAX_DEPTH, Bvh, Tree, aligned_empty, bvh_link, line_at, link_at
from .top_levels import Subtrees, UpperLevels
from .triangle_bounds import INF, half_area, range_bounds, record_id, write_boxes

# --- Optimal subtrees -------------------------------------------------------------------------------------------------


OPTIMAL_SIZE = 4  # maximum records below an optimal subtree
_SUBSETS = 1 << OPTIMAL_SIZE
_SUBSET_BOXES = 8 * _SUBSETS
_TODO = 2 * OPTIMAL_SIZE


class SubsetPlans(NamedTuple):
    """The optimal tree over each subset of the records. The bits of a subset's index are its records."""

    boxes: F32Ptr  # (16, 8) float32
    cost: F32Ptr  # (16,) float32
    left: I32Ptr  # (16,) int32: the subset that becomes the left child; 0 for a leaf


@kernel
def _cheapest_halves(cost, subset):
    """(cost, left child) of the cheapest division of a subset of two or more records."""
    low = subset & -subset
    others = subset ^ low
    best, best_half = INF, low
    part = (others - 1) & others
    while True:
        half = low | part
        both = get(cost, half) + get(cost, subset ^ half)
        if both < best:
            best, best_half = both, half
        if part == 0:
            return best, best_half
        part = (part - 1) & others


@kernel
def _plan(records, first, n, max_leaf, scale, plans):
    """Fill `plans` for `n` records from `first` on. Visiting a node and testing a triangle cost 1 each."""
    for subset in range(1, 1 << n):
        others = subset & (subset - 1)
        box = load8(records, (first + lowest_bit(subset)) * 8)
        if others != 0:
            box = minimum(box, load8(plans.boxes, others * 8))
        store(plans.boxes, subset * 8, box)
        area, size = half_area(box, scale), popcount(subset)
        cost, half = np.float32(size) * area, 0
        if size > 1:
            divided, halves = _cheapest_halves(plans.cost, subset)
            if size > max_leaf or divided + area < cost:
                cost, half = divided + area, halves
        put(plans.cost, subset, cost)
        put(plans.left, subset, half)


@kernel
def build_optimal_subtree(records, first, n, settings, out, next_node, slot, is_root):
    """Write the optimal tree over 1 to OPTIMAL_SIZE records, and return the index of the next free node.

    The root of the whole tree is never a leaf.
    """
    # In: records, float32 *, of which `n` from `first` on are used; settings, max_leaf and scale; is_root, bool
    # Out: out, a `Tree`, nodes from `next_node` on; out.links[slot], the link to the tree
    plans = SubsetPlans(stack_f32(_SUBSET_BOXES), stack_f32(_SUBSETS), stack_i32(_SUBSETS))
    todo = stack_i32(_TODO)
    everything = np.int64((1 << n) - 1)
    _plan(records, first, n, settings.max_leaf, settings.scale, plans)
    if is_root and get(plans.left, everything) == 0:
        put(plans.left, everything, _cheapest_halves(plans.cost, everything)[1])
    put(todo, 0, everything)
    put(todo, 1, slot)
    height, cursor = 1, first
    while height > 0:
        height -= 1
        subset, slot = get(todo, 2 * height), get(todo, 2 * height + 1)
        left_half = get(plans.left, subset)
        if left_half == 0:
            put(out.links, slot, bvh_link(cursor, popcount(subset)))
            while subset != 0:
                put(out.prim_ids, cursor, record_id(records, first + lowest_bit(subset)))
                cursor += 1
                subset &= subset - 1
            continue
        put(out.links, slot, next_node)
        right_half = subset ^ left_half
        write_boxes(out.nodes, next_node, load8(plans.boxes, left_half * 8), load8(plans.boxes, right_half * 8))
        put(todo, 2 * height, right_half)
        put(todo, 2 * height + 1, link_at(next_node, 1))
        put(todo, 2 * height + 2, left_half)
        put(todo, 2 * height + 3, link_at(next_node, 0))
        height += 2
        next_node += 1
    return next_node


# --- The subtree of a range, depth first and in place -----------------------------------------------------------------


_STACK_SIZE = MAX_DEPTH + 1  # ranges: one right child per level, and one left child
_NUMBERS = 4 * _STACK_SIZE
_BOXES = 16 * _STACK_SIZE
_AHEAD = 8  # prefetch distance in slots


class Settings(NamedTuple):
    """Settings for all ranges of a scene."""

    max_leaf: np.int64
    scale: np.float32  # a power of two that scales the largest coordinate to about 1, so that no area overflows


class Range(NamedTuple):
    """A range of records."""

    first: int
    last: int  # exclusive
    depth: int
    box: Any  # f32x8, like the next
    centroids: Any  # box of the centroids


class Ranges(NamedTuple):
    """A stack of ranges to build."""

    numbers: I32Ptr  # int32 *, 4 per range: first, last, depth, word of `links`
    boxes: F32Ptr  # float32 *, 16 per range: box, centroid box


@kernel
def push_range(ranges, height, part, slot):
    """Push a `Range`, whose link is written to word `slot`, on the stack. Return the new height."""
    put(ranges.numbers, height * 4, part.first)
    put(ranges.numbers, height * 4 + 1, part.last)
    put(ranges.numbers, height * 4 + 2, part.depth)
    put(ranges.numbers, height * 4 + 3, slot)
    store(ranges.boxes, height * 16, part.box)
    store(ranges.boxes, height * 16 + 8, part.centroids)
    return height + 1


@inlined
def range_at(ranges, height):
    """(the `Range` at a height of the stack, the word of its link)."""
    numbers, boxes = ptr_at(ranges.numbers, height * 4), ptr_at(ranges.boxes, height * 16)
    first, last, depth = get(numbers, 0), get(numbers, 1), get(numbers, 2)
    return Range(first, last, depth, load8(boxes, 0), load8(boxes, 8)), get(numbers, 3)


@inlined
def part_of(records, first, last, depth):
    """The `Range` of the records from `first` to `last` - 1."""
    box, centroids = range_bounds(records, first, last)
    return Range(first, last, depth, box, centroids)


@kernel
def _leaf_is_cheaper(n, depth, box, split, settings):
    """Whether a leaf is cheaper than the split of a range; never for the root."""
    if n > settings.max_leaf or depth == 0:
        return False
    area = half_area(box, settings.scale)
    return not (area + split.cost < area * np.float32(n))


@kernel
def write_leaf(records, first, last, out, slot):
    """Write the link to a leaf, and the triangles of its slots."""
    put(out.links, slot, bvh_link(first, last - first))
    for i in range(first, last):
        put(out.prim_ids, i, record_id(records, i))


@kernel
def copy_corners(vertices, first, last, out):
    """Copy the vertices of the triangles in slots `first` to `last` - 1."""
    for i in range(first, last):
        prefetch(vertices, get(out.prim_ids, min(i + _AHEAD, last - 1)) * 9)
        source = get(out.prim_ids, i) * 9
        store(out.corners, i * 9, load8(vertices, source))
        put(out.corners, i * 9 + 8, get(vertices, source + 8))


@kernel
def build_subtree(source, part, settings, out, next_node, word):
    """Build the tree over the records of a range, and return the index of the next free node.

    Its nodes start at `next_node`, in depth-first order. n records make at most n - 1 nodes.
    """
    # In: source, of `source_of`; part, a `Range`; settings, `Settings`
    # Out: out, a `Tree`: nodes, links, prim_ids; out.links[word], the link to the tree
    ranges = Ranges(stack_i32(_NUMBERS), stack_f32(_BOXES))
    records = source.records
    height = push_range(ranges, 0, part, word)
    while height > 0:
        height -= 1
        (b, e, d, box, centroids), slot = range_at(ranges, height)
        if e - b <= OPTIMAL_SIZE and d + e - b - 1 <= MAX_DEPTH:
            next_node = build_optimal_subtree(records, b, e - b, settings, out, next_node, slot, d == 0)
            continue
        split = find_split(source, b, e, centroids, d, settings.scale)
        if _leaf_is_cheaper(e - b, d, box, split, settings):
            write_leaf(records, b, e, out, slot)
            continue
        m = divide(source, b, e, centroids, split)
        left, right = part_of(records, b, m, d + 1), part_of(records, m, e, d + 1)
        put(out.links, slot, next_node)
        write_boxes(out.nodes, next_node, left.box, right.box)
        height = push_range(ranges, height, right, link_at(next_node, 1))
        height = push_range(ranges, height, left, link_at(next_node, 0))
        next_node += 1
    return next_node


@overloaded("top_down")
def build_range(vertices, source, part, settings, s, out):
    """In kernels: build the tree over range s of those below the top levels, and return its number of nodes.

    The type of `settings` selects the implementation. The nodes are 1, 2, ... of `out`. The left link of node 0 becomes
    the link to the tree; nothing else of node 0 is written.
    """
    # In: vertices, float32 *, 9 per triangle; the rest as for `build_subtree`
    # Out: out, a `Tree`: nodes, links, prim_ids, corners


@overload(build_range)
def _build_range(vertices, source, part, settings, s, out):
    if settings.instance_class is Settings:

        def build(vertices, source, part, settings, s, out):
            next_node = build_subtree(source, part, settings, out, 1, np.int64(LINK))
            copy_corners(vertices, part.first, part.last, out)
            return next_node - 1

        return build


# --- All subtrees -----------------------------------------------------------------------------------------------------


_SUBTREES = 64  # the top levels split ranges of more than 1/64 of all records, so that threads finish together
MIN_PARALLEL_RANGE = 4096  # the top levels split no smaller range: one thread builds it before others wake up


def largest_subtree(n: int) -> int:
    """The maximum number of records in a range that one thread builds alone, for `n` records in total."""
    return max(MIN_PARALLEL_RANGE, n // _SUBTREES)


def largest_binned(n: int) -> int:
    """`largest_subtree` if all threads bin the ranges of a level together, which wakes them twice."""
    return max(2 * MIN_PARALLEL_RANGE, n // _SUBTREES)


class _Memory(NamedTuple):
    """One thread's memory for building a subtree."""

    nodes: NDArray[np.float32]  # (largest, 16) float32: the subtree's nodes
    scratch: NDArray[np.float32]  # (words,) float32, for `source_of`


@kernel
def _build_subtrees(ticket, vertices, method, top, order, settings, bvh, subtrees, next_free, memory):
    """Worker: build the subtrees in `order`, and copy the nodes of each to the next free place."""
    # In: vertices; method, `Binned` or `SortedRecords`; top, `UpperLevels`; order, (s,) int64; settings
    # Out: bvh, prim_ids and corners; subtrees, `Subtrees`; next_free, (1,) int64, counts nodes
    # Scratch: memory, the per-thread `_Memory`
    part_nodes, scratch = memory.nodes, memory.scratch
    out = Tree(ptr(part_nodes), as_i32(part_nodes), ptr(bvh.prim_ids), ptr(bvh.corners))
    for k in items(ticket):
        s = order[k]
        first, last, depth = top.ranges[s]
        part = Range(first, last, depth, load8(top.range_boxes, s * 16), load8(top.range_boxes, s * 16 + 8))
        count = build_range(ptr(vertices), source_of(method, depth, ptr(scratch)), part, settings, s, out)
        at = atomic_add(next_free, 0, count)
        for i in range(count):
            store(subtrees.nodes, line_at(at + i), load16(part_nodes, line_at(i + 1)))
        subtrees.shares[s, 0], subtrees.shares[s, 1], subtrees.shares[s, 2] = at, count, get(out.links, LINK)


def build_below(
    flat: NDArray[np.float32], method: Any, words: int, top: UpperLevels, settings: Any, threads: int
) -> tuple[Bvh, Subtrees]:
    """Build the subtrees below the top levels over triangles `flat`, (n, 9) float32. `assemble` completes the tree.

    method : `Binned`, `SortedRecords` or another method (`binned_split`)
    settings : of a type for which `build_range` is implemented
    words : number of float32 of scratch memory that `source_of` needs
    """
    n, s = len(flat), len(top.ranges)
    subtrees = Subtrees(aligned_empty((n, 16), "f4"), np.empty((s, 3), np.int64))
    bvh = Bvh(subtrees.nodes, subtrees.nodes.view(np.int32), aligned_empty((n,), "i4"), aligned_empty((n, 9), "f4"))
    sizes = top.ranges[:, 1] - top.ranges[:, 0]
    order, largest = np.argsort(-sizes, kind="stable"), int(sizes.max())
    next_free, args = np.zeros(1, np.int64), (flat, method, top, order, settings, bvh, subtrees)
    make_memory = lambda: (_Memory(aligned_empty((largest, 16), "f4"), np.empty(words, np.float32)),)
    run_short(_build_subtrees, threads, new_ticket(s, 1), *args, next_free, own=make_memory)
    return bvh, subtrees
