"""One thread's share of a build: the subtree of a range of records, depth first and in place."""

from typing import NamedTuple

import numpy as np

from ..kernels.jit import F32Ptr, I32Ptr, kernel, overload, overloaded
from ..kernels.simd import get, load8, prefetch, put, stack_f32, stack_i32, store
from .bounds import half_area, range_bounds, record_id, write_boxes
from .links import bvh_link, link_at
from .nodes import MAX_DEPTH
from .smallest import SMALLEST, build_smallest
from .splits import divide, find_split

_WAITING = MAX_DEPTH + 1  # waiting ranges: the right child at each level, and a left one
_NUMBERS = 4 * _WAITING
_BOXES = 16 * _WAITING
_AHEAD = 8  # slots whose corners are fetched in advance


class Settings(NamedTuple):
    """Settings for all ranges of a scene."""

    max_leaf: int
    scale: np.float32  # a power of two: scales the largest coordinate to about 1, so no area overflows


class Ranges(NamedTuple):
    """A stack of ranges to build."""

    numbers: I32Ptr  # int32 *, 4 a range: first, last, depth, word of `links`
    boxes: F32Ptr  # float32 *, 16 a range: box, centroid box


@kernel
def push_range(ranges, height, first, last, depth, slot, box, centroids):
    put(ranges.numbers, height * 4, first)
    put(ranges.numbers, height * 4 + 1, last)
    put(ranges.numbers, height * 4 + 2, depth)
    put(ranges.numbers, height * 4 + 3, slot)
    store(ranges.boxes, height * 16, box)
    store(ranges.boxes, height * 16 + 8, centroids)
    return height + 1


@kernel
def _leaf_is_cheaper(n, depth, box, split, settings):
    """Whether a leaf costs less than the split of a range; never for the root."""
    if n > settings.max_leaf or depth == 0:
        return False
    area = half_area(box, settings.scale)
    return not (area + split.cost < area * np.float32(n))


@kernel
def write_leaf(records, first, last, out, slot):
    put(out.links, slot, bvh_link(first, last - first))
    for i in range(first, last):
        put(out.prim_ids, i, record_id(records, i))


@kernel
def copy_corners(vertices, first, last, out):
    """Copy the vertices of the triangles in slots `first` to `last` - 1."""
    for i in range(first, last):
        prefetch(vertices, np.int64(get(out.prim_ids, min(i + _AHEAD, last - 1))) * 9)
        source = np.int64(get(out.prim_ids, i)) * 9
        store(out.corners, i * 9, load8(vertices, source))
        put(out.corners, i * 9 + 8, get(vertices, source + 8))


@kernel
def grow(source, first, last, depth, box, centroids, settings, out, next_node, word):
    """Build the tree over the records from `first` to `last` - 1, and return the index of the next free node.

    Its nodes start at `next_node`, depth first. n records make at most n - 1 nodes.
    """
    # In: source, of `source_of`; first, last, depth; box, centroids, f32x8; settings, `Settings`
    # Out: out, a `Tree`: nodes, links, prim_ids; out.links[word], the link to the tree
    ranges = Ranges(stack_i32(_NUMBERS), stack_f32(_BOXES))
    records = source.records
    height = push_range(ranges, 0, first, last, depth, word, box, centroids)
    while height > 0:
        height -= 1
        b, e = np.int64(get(ranges.numbers, height * 4)), np.int64(get(ranges.numbers, height * 4 + 1))
        d, slot = np.int64(get(ranges.numbers, height * 4 + 2)), np.int64(get(ranges.numbers, height * 4 + 3))
        if e - b <= SMALLEST and d + e - b - 1 <= MAX_DEPTH:
            next_node = build_smallest(records, b, e - b, settings, out, next_node, slot, d == 0)
            continue
        here, centroids = load8(ranges.boxes, height * 16), load8(ranges.boxes, height * 16 + 8)
        split = find_split(source, b, e, centroids, d, settings.scale)
        if _leaf_is_cheaper(e - b, d, here, split, settings):
            write_leaf(records, b, e, out, slot)
            continue
        m = divide(source, b, e, centroids, split)
        left, left_centroids = range_bounds(records, b, m)
        right, right_centroids = range_bounds(records, m, e)
        put(out.links, slot, next_node)
        write_boxes(out.nodes, next_node, left, right)
        height = push_range(ranges, height, m, e, d + 1, link_at(next_node, 1), right, right_centroids)
        height = push_range(ranges, height, b, m, d + 1, link_at(next_node, 0), left, left_centroids)
        next_node += 1
    return next_node


@overloaded("top_down")
def build_range(vertices, source, first, last, depth, box, centroids, settings, s, out):
    """In kernels: build the tree over range s of the ranges that one thread builds, and return its number of nodes.

    The type of `settings` chooses the implementation. The nodes are 1, 2, ... of `out`. The left link of node 0 becomes
    the link to the tree. The rest of node 0 is not written.
    """
    # In: vertices, float32 *, 9 a triangle; source, first, last, depth, box, centroids, settings, as for `grow`
    # Out: out, a `Tree`: nodes, links, prim_ids, corners


@overload(build_range)
def _build_range(vertices, source, first, last, depth, box, centroids, settings, s, out):
    if settings.instance_class is Settings:

        def build(vertices, source, first, last, depth, box, centroids, settings, s, out):
            next_node = grow(source, first, last, depth, box, centroids, settings, out, np.int64(1), np.int64(12))
            copy_corners(vertices, first, last, out)
            return next_node - 1

        return build
