"""Splits of a range of records: the interface of top-down builders, and binned SAH splits [Wald 2007].

A *method* holds a builder's arrays of records: such as `Binned`. Top-down builders differ only in
their splits and share the rest (`top_down`). Inside kernels, the method's type selects the implementation of the
functions here at compile time.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..kernels.jit import F32Ptr, F32x4, I32Ptr, inlined, kernel, overload, overloaded
from ..kernels.simd import (
    as_i32,
    extract,
    get,
    load4,
    load8,
    maximum,
    minimum,
    ptr,
    ptr_at,
    put,
    select,
    splat8,
    stack_f32,
    store,
    swap_halves,
    to_i32,
)
from .nodes import MAX_DEPTH, aligned_empty
from .triangle_bounds import INF, half_area

# --- The interface of splits ------------------------------------------------------------------------------------------


class Split(NamedTuple):
    """The split of a range. `axis` is -1 if no split has a finite cost and the range is halved."""

    axis: np.int64
    place: np.int64  # the first bin (`bsah`) or the first record (`sweep-sah`) on the right
    cost: np.float32  # sum over both sides of half the area times the number of records


@kernel
def no_split():
    """The split that halves a range."""
    return Split(-1, 0, INF)


@kernel
def must_halve(n, depth):
    """Whether a node at this depth must be halved to keep its tree within MAX_DEPTH.

    Otherwise, each child has fewer than 2 ** (MAX_DEPTH - 1 - depth) records, so halving still suffices below it.
    """
    return (n >> (MAX_DEPTH - 1 - depth)) > 0


@overloaded("binned_split")
def source_of(method, depth, scratch):
    """In kernels: pointers to the records of ranges at this depth. The field `records` holds them in any order.

    scratch : float32 *, as much as the method needs
    """


@overloaded("binned_split")
def find_split(source, first, last, centroids, depth, scale):
    """In kernels: the `Split` of the records from `first` to `last` - 1, whose centroid box is `centroids`."""


@overloaded("binned_split")
def divide(source, first, last, centroids, split):
    """In kernels: move a range's left records before its right ones, and return the index of the first right record."""


# --- Binned SAH splits [Wald 2007] ------------------------------------------------------------------------------------


BINS = 32  # per axis, at most
BIN_COUNTS = 3 * BINS
BIN_BOXES = BIN_COUNTS * 8
BIN_WORDS = BIN_BOXES + BIN_COUNTS
_BELOW_ONE = np.float32(1.0 - 2.0**-20)  # keeps the largest centroid in the last bin


class Bins(NamedTuple):
    """Memory for the bins of a range: pointers to 3 x BINS boxes (8 float32 each) and 3 x BINS counts."""

    boxes: F32Ptr
    counts: I32Ptr


class Mapping(NamedTuple):
    """Maps twice a centroid to its bin on each axis: truncate((c - origin) * factor)."""

    origin: F32x4  # f32x4
    factor: F32x4  # f32x4; 0 on axes where all centroids (nearly) coincide
    n_bins: int


class Binned(NamedTuple):
    """The method of `bsah`, with two arrays of records.

    While all threads split ranges together, a range is in `records` at even depths and in `spare` at odd depths. Below
    these levels, it stays where it is.
    """

    records: NDArray[np.float32]  # (n, 8) float32
    spare: NDArray[np.float32]  # (n, 8) float32 and an eighth more, so that the nodes of most trees fit in the end


def binned(n: int) -> Binned:
    """A `Binned` with memory for n records."""
    return Binned(aligned_empty((n, 8), "f4"), aligned_empty((n + n // 8, 8), "f4"))


class BinnedSource(NamedTuple):
    """Pointers of `Binned`."""

    records: F32Ptr
    bins: Bins


@kernel
def bin_count(n):
    """The number of bins for n records; few records would leave many bins empty."""
    return min(np.int64(BINS), 4 + n // 16)


@kernel
def make_mapping(centroids, n):
    """The `Mapping` of `n` records with this centroid box."""
    n_bins = bin_count(n)
    sides = -(centroids + swap_halves(centroids))
    store_at = stack_f32(16)
    store(store_at, 0, centroids)
    store(store_at, 8, sides)
    factor = (np.float32(n_bins) * _BELOW_ONE) / load4(store_at, 8)
    factor = select(factor < INF, factor, np.float32(0.0))  # also turns NaN into 0
    return Mapping(load4(store_at, 0), factor, n_bins)


@kernel
def clear_bins(bins, n_bins):
    """Empty the bins of all three axes."""
    for k in range(3 * n_bins):
        store(bins.boxes, k * 8, splat8(INF))
        put(bins.counts, k, 0)


@inlined
def _add_to_bin(bins, k, record):
    """Add a record to bin k."""
    store(bins.boxes, k * 8, minimum(load8(bins.boxes, k * 8), record))
    put(bins.counts, k, get(bins.counts, k) + 1)


@inlined
def _add_record(records, i, mapping, bins):
    """Add record i to its bin on each axis."""
    record, n_bins = load8(records, i * 8), mapping.n_bins
    centroid = load4(records, i * 8) - load4(records, i * 8 + 4)
    place = to_i32((centroid - mapping.origin) * mapping.factor)
    place = minimum(maximum(place, np.int32(0)), np.int32(n_bins - 1))
    _add_to_bin(bins, np.int64(extract(place, 0)), record)
    _add_to_bin(bins, np.int64(extract(place, 1)) + n_bins, record)
    _add_to_bin(bins, np.int64(extract(place, 2)) + 2 * n_bins, record)


@kernel
def fill_bins(records, first, last, mapping, bins):
    """Add the records from `first` to `last` - 1 to the bins.

    Neighbours often share a bin, and then wait for each other's store. Records far apart are added in turn.
    """
    quarter = (last - first) >> 2
    for i in range(first, first + quarter):
        for k in range(4):
            _add_record(records, i + k * quarter, mapping, bins)
    for i in range(first + 4 * quarter, last):
        _add_record(records, i, mapping, bins)


@kernel
def cheapest_split(bins, n_bins, scale):
    """The cheapest split at a boundary between bins, over all axes."""
    right = stack_f32(BINS)
    best, best_axis, best_bin = INF, -1, 0
    for axis in range(3):
        base = axis * n_bins
        box, count = splat8(INF), 0
        for k in range(n_bins - 1, 0, -1):
            box = minimum(box, load8(bins.boxes, (base + k) * 8))
            count += get(bins.counts, base + k)
            put(right, k, half_area(box, scale) * np.float32(count))
        box, count = splat8(INF), 0
        for k in range(1, n_bins):
            box = minimum(box, load8(bins.boxes, (base + k - 1) * 8))
            count += get(bins.counts, base + k - 1)
            cost = half_area(box, scale) * np.float32(count) + get(right, k)
            if cost < best:  # false if a side is empty: infinite area times 0 is NaN
                best, best_axis, best_bin = cost, np.int64(axis), np.int64(k)
    return Split(best_axis, best_bin, best)


@kernel
def goes_left(records, i, axis, origin, factor, limit):
    """Whether the record's bin on `axis` is below `limit`, rounded as in `fill_bins`."""
    centroid = get(records, i * 8 + axis) - get(records, i * 8 + axis + 4)
    return (centroid - origin) * factor < limit


@kernel
def partition(records, first, last, mapping, split):
    """Move a range's left records to its front, and return the index of the first right record.

    This is Lomuto's scheme. Both stores are unconditional, because the next record's side is unpredictable.
    """
    origin, factor = extract(mapping.origin, split.axis), extract(mapping.factor, split.axis)
    limit, middle = np.float32(split.place), first
    for i in range(first, last):
        is_left = goes_left(records, i, split.axis, origin, factor, limit)
        record, other = load8(records, i * 8), load8(records, middle * 8)
        store(records, middle * 8, record)
        store(records, i * 8, other)
        middle += np.int64(is_left)
    return middle


@overload(source_of)
def _source_of(method, depth, scratch):
    if method.instance_class is Binned:

        def source(method, depth, scratch):
            records = ptr(method.spare) if depth & 1 else ptr(method.records)
            return BinnedSource(records, Bins(scratch, as_i32(ptr_at(scratch, BIN_BOXES))))

        return source


@overload(find_split)
def _find_split(source, first, last, centroids, depth, scale):
    if source.instance_class is BinnedSource:

        def find(source, first, last, centroids, depth, scale):
            n = last - first
            if must_halve(n, depth):
                return no_split()
            mapping = make_mapping(centroids, n)
            clear_bins(source.bins, mapping.n_bins)
            fill_bins(source.records, first, last, mapping, source.bins)
            return cheapest_split(source.bins, mapping.n_bins, scale)

        return find


@overload(divide)
def _divide(source, first, last, centroids, split):
    if source.instance_class is BinnedSource:

        def cut(source, first, last, centroids, split):
            if split.axis < 0:
                return (first + last) >> 1
            return partition(source.records, first, last, make_mapping(centroids, last - first), split)

        return cut
