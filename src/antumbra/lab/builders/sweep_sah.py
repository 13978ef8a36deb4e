"""`sweep-sah`: a top-down builder with the full SAH sweep [MacDonald and Booth 1990], as in [Wald 2007, Sec. 3].

It builds as `bsah` does, but splits a range at the best of all positions between two centroids on three axes, the split
of least SAH cost. In the top levels, each range is split by one thread.

Records are sorted by centroid once per axis, as [Wald and Havran 2006, Sec. 4.3] do for kd-trees. Ties are broken by
index. A split divides all three sorted arrays and preserves their order.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...bvh.binned_split import Split, divide, find_split, must_halve, no_split, source_of
from ...bvh.morton_sort import radix_sort
from ...bvh.nodes import Bvh, aligned_empty
from ...bvh.top_down import Settings, build_below, largest_subtree
from ...bvh.top_levels import SplitLevel, assemble, build_top
from ...bvh.triangle_bounds import (
    INF,
    area_scale_for,
    checked_vertices,
    half_area,
    longest_side,
    make_records,
    range_bounds,
    trivial_bvh,
)
from ...kernels.jit import F32Ptr, inlined, kernel, overload
from ...kernels.parallel import items, new_ticket, run, thread_count
from ...kernels.simd import as_i32, get, load8, minimum, ptr, put, splat8, store

# --- The full sweep ---------------------------------------------------------------------------------------------------


SWEEP_WORDS = 8  # words of scratch memory per record


class SortedRecords(NamedTuple):
    """The method of `sweep-sah`: the records sorted by centroid per axis. A range has the same place in each array."""

    x: NDArray[np.float32]  # (n, 8) float32
    y: NDArray[np.float32]  # (n, 8) float32
    z: NDArray[np.float32]  # (n, 8) float32


class SortedSource(NamedTuple):
    """Pointers to the arrays of `SortedRecords`."""

    records: F32Ptr  # float32 *, sorted by x
    y: F32Ptr  # float32 *
    z: F32Ptr  # float32 *
    scratch: F32Ptr  # float32 *, 8 per record of a range


@inlined
def _sorted_records(source, axis):
    """The records sorted on an axis."""
    return source.records if axis == 0 else source.y if axis == 1 else source.z


@inlined
def _centroid(records, i, axis):
    return get(records, i * 8 + axis) - get(records, i * 8 + axis + 4)


@kernel
def _sweep(records, first, last, axis, scale, right, best):
    """The cheaper of `best` and the best split on `axis` of a range sorted on it."""
    # In: records, float32 *; first, last; axis; scale; best, the best `Split` so far
    # Scratch: right, float32 *, last - first
    box = splat8(INF)
    for i in range(last - 1, first, -1):
        box = minimum(box, load8(records, i * 8))
        put(right, i - first, half_area(box, scale) * np.float32(last - i))
    box = splat8(INF)
    for i in range(first + 1, last):
        box = minimum(box, load8(records, (i - 1) * 8))
        cost = half_area(box, scale) * np.float32(i - first) + get(right, i - first)
        if cost < best.cost:
            best = Split(np.int64(axis), i, cost)
    return best


@kernel
def _divide_order(records, first, last, axis, centroid, index, scratch):
    """Move the records before (centroid, index) on `axis` to the front, preserving the order on both sides."""
    # In: first, last; axis, centroid, index: the first right record's axis, double centroid and index word
    # Out: records, float32 *, reordered
    # Scratch: scratch, float32 *, 8 per record
    ids = as_i32(records)
    next_left, n_right = first, 0
    for i in range(first, last):
        record, c = load8(records, i * 8), _centroid(records, i, axis)
        goes_left = c < centroid or (c == centroid and get(ids, i * 8 + 3) < index)
        store(records, next_left * 8, record)  # overwrites only records that have moved; both stores are unconditional
        store(scratch, n_right * 8, record)
        next_left += np.int64(goes_left)
        n_right += np.int64(not goes_left)
    for i in range(n_right):
        store(records, (next_left + i) * 8, load8(scratch, i * 8))


@overload(source_of)
def _source_of(method, depth, scratch):
    if method.instance_class is SortedRecords:
        return lambda method, depth, scratch: SortedSource(ptr(method.x), ptr(method.y), ptr(method.z), scratch)


@overload(find_split)
def _find_split(source, first, last, centroids, depth, scale):
    if source.instance_class is SortedSource:

        def find(source, first, last, centroids, depth, scale):
            best = no_split()
            if must_halve(last - first, depth) or longest_side(centroids) == 0:
                return best
            for axis in range(3):
                best = _sweep(_sorted_records(source, axis), first, last, axis, scale, source.scratch, best)
            return best

        return find


@overload(divide)
def _divide(source, first, last, centroids, split):
    if source.instance_class is SortedSource:

        def cut(source, first, last, centroids, split):
            axis, middle = max(split.axis, 0), split.place
            if split.axis < 0:
                middle = (first + last) >> 1
            records = _sorted_records(source, axis)
            centroid, index = _centroid(records, middle, axis), get(as_i32(records), middle * 8 + 3)
            for other in range(3):
                if other != axis:
                    _divide_order(_sorted_records(source, other), first, last, axis, centroid, index, source.scratch)
            return middle

        return cut


# --- The builder ------------------------------------------------------------------------------------------------------


def _sort_by_centroid(records: NDArray[np.float32], axis: int, threads: int) -> NDArray[np.float32]:
    """The records sorted by centroid on an axis, with ties broken by index."""
    bits = (records[:, axis] - records[:, axis + 4] + np.float32(0.0)).view(np.int32)  # turns -0 into +0
    keys = bits ^ ((bits >> 31) | np.int32(-(2**31)))  # unsigned keys in the order of the floats
    order = radix_sort(keys, np.arange(len(records), dtype=np.int32), 32, threads)[1]
    out = aligned_empty(records.shape, "f4")
    return np.take(records, order, axis=0, out=out)


@kernel
def _split_ranges(ticket, method, ranges, boxes, depth, scale, middles, sides, scratch):
    """Worker: split ranges, and bound both sides of each."""
    # In: method, `SortedRecords`; ranges, (k, 2) first and last record; boxes, (k, 16); depth; scale
    # Out: middles, (k,) first right record; sides, (k, 32) box and centroid box of both sides
    # Scratch: scratch, per-thread memory for `source_of`
    for r in items(ticket):
        first, last = ranges[r]
        source, centroids = source_of(method, depth, ptr(scratch)), load8(boxes, r * 16 + 8)
        split = find_split(source, first, last, centroids, depth, scale)
        middle = divide(source, first, last, centroids, split)
        left_box, left_centroids = range_bounds(source.records, first, middle)
        right_box, right_centroids = range_bounds(source.records, middle, last)
        store(sides, r * 32, left_box)
        store(sides, r * 32 + 8, left_centroids)
        store(sides, r * 32 + 16, right_box)
        store(sides, r * 32 + 24, right_centroids)
        middles[r] = middle


def _split_by_sweep(method: SortedRecords, scale: np.float32, threads: int) -> SplitLevel:
    """The `split_level` of `build_top` that splits each range by one thread."""

    def split_level(
        ranges: NDArray[np.int64], boxes: NDArray[np.float32], depth: int
    ) -> tuple[NDArray[np.int64], NDArray[np.float32]]:
        k, words = len(ranges), SWEEP_WORDS * int((ranges[:, 1] - ranges[:, 0]).max())
        middles, sides = np.empty(k, np.int64), np.empty((k, 32), np.float32)
        make_scratch = lambda: (np.empty(words, np.float32),)
        run(
            _split_ranges,
            threads,
            new_ticket(k, 1),
            method,
            ranges,
            boxes,
            depth,
            scale,
            middles,
            sides,
            own=make_scratch,
        )
        return middles, sides

    return split_level


def build(vertices: NDArray[np.float32], threads: int | None = None, max_leaf: int = 4) -> Bvh:
    """Build a BVH with the full SAH sweep. The tree is bitwise identical for any number of threads.

    Parameters, errors and the result are as for `binned_sah.build`.
    """
    flat, threads = checked_vertices(vertices, max_leaf), thread_count(threads)
    n = len(flat)
    records = aligned_empty((n, 8), "f4")
    box, centroids = make_records(flat, records, threads)
    if n < 2:
        return trivial_bvh(flat)
    method = SortedRecords(*(_sort_by_centroid(records, axis, threads) for axis in range(3)))
    settings = Settings(np.int64(max_leaf), area_scale_for(box))
    top = build_top(n, box, centroids, largest_subtree(n), _split_by_sweep(method, settings.scale, threads))
    bvh, subtrees = build_below(flat, method, SWEEP_WORDS * largest_subtree(n), top, settings, threads)
    del method, records  # frees memory for the final nodes
    return assemble(bvh, top, subtrees, threads)
