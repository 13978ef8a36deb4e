"""The tree of least SAH cost over up to four records, out of all trees.

Most of a tree's nodes have at most four triangles below them. There binning is slow and finds little. With n <= 4 there
are at most 11 subsets of two or more records. The best tree over each subset follows from the best trees over smaller
ones [Karras and Aila 2013, "Fast parallel construction of high-quality bounding volume hierarchies"].
"""

from typing import NamedTuple

import numpy as np

from ..kernels.jit import F32Ptr, I32Ptr, kernel
from ..kernels.simd import get, load8, lowest_bit, minimum, popcount, put, stack_f32, stack_i32, store
from .bounds import INF, half_area, record_id, write_boxes
from .links import bvh_link, link_at

SMALLEST = 4  # records, at most
_SUBSETS = 1 << SMALLEST
_BOXES = 8 * _SUBSETS
_TODO = 2 * SMALLEST


class Plans(NamedTuple):
    """The best tree over each subset of the records. The bits of a subset's index are its records."""

    boxes: F32Ptr  # (16, 8) float32
    cost: F32Ptr  # (16,) float32
    left: I32Ptr  # (16,) int32: the subset that becomes the left child; 0 for a leaf


@kernel
def _cheapest_halves(cost, subset):
    """(cost, left child) of the cheapest division of a subset of two or more."""
    low = subset & -subset
    rest = subset ^ low
    best, best_left = INF, low
    part = (rest - 1) & rest
    while True:
        left = low | part
        both = get(cost, left) + get(cost, subset ^ left)
        if both < best:
            best, best_left = both, left
        if part == 0:
            return best, best_left
        part = (part - 1) & rest


@kernel
def _plan(records, first, n, max_leaf, scale, plans):
    """Fill `plans` for `n` records from `first` on. Visiting a node and testing a triangle cost 1 each."""
    for subset in range(1, 1 << n):
        rest = subset & (subset - 1)
        box = load8(records, (first + lowest_bit(subset)) * 8)
        if rest != 0:
            box = minimum(box, load8(plans.boxes, rest * 8))
        store(plans.boxes, subset * 8, box)
        area, size = half_area(box, scale), popcount(subset)
        cost, left = np.float32(size) * area, np.int64(0)
        if size > 1:
            divided, halves = _cheapest_halves(plans.cost, subset)
            if size > max_leaf or divided + area < cost:
                cost, left = divided + area, halves
        put(plans.cost, subset, cost)
        put(plans.left, subset, left)


@kernel
def build_smallest(records, first, n, settings, out, next_node, slot, is_root):
    """Write the best tree over 1 to SMALLEST records, and return the index of the next free node.

    A root is never a leaf.
    """
    # In: records, float32 *, from which `n` count from `first` on; settings, max_leaf and scale; is_root, bool
    # Out: out, a `Tree`, nodes from `next_node` on; out.links[slot], the link to the tree
    plans = Plans(stack_f32(_BOXES), stack_f32(_SUBSETS), stack_i32(_SUBSETS))
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
        subset, slot = np.int64(get(todo, 2 * height)), np.int64(get(todo, 2 * height + 1))
        left = np.int64(get(plans.left, subset))
        if left == 0:
            put(out.links, slot, bvh_link(cursor, popcount(subset)))
            while subset != 0:
                put(out.prim_ids, cursor, record_id(records, first + lowest_bit(subset)))
                cursor += 1
                subset &= subset - 1
            continue
        put(out.links, slot, next_node)
        right = subset ^ left
        write_boxes(out.nodes, next_node, load8(plans.boxes, left * 8), load8(plans.boxes, right * 8))
        put(todo, 2 * height, right)
        put(todo, 2 * height + 1, link_at(next_node, 1))
        put(todo, 2 * height + 2, left)
        put(todo, 2 * height + 3, link_at(next_node, 0))
        height += 2
        next_node += 1
    return next_node
