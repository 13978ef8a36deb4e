"""The full sweep: the split of least SAH cost among all splits of a range by centroid, on three axes.

Records are sorted by their centroids once for each axis, as [Wald and Havran 2006, Sec. 4.3] do for kd-trees. Equal
centroids are ordered by index. A split divides all three orders, and keeps them.
"""

from typing import NamedTuple

import numpy as np

from ..kernels.jit import F32Ptr, inlined, kernel, overload
from ..kernels.simd import as_i32, get, load8, minimum, ptr, put, splat8, store
from .bounds import INF, half_area, width
from .splits import Split, divide, find_split, must_halve, no_split, source_of

SWEEP_WORDS = 8  # words of scratch memory for a record


class Swept(NamedTuple):
    """The method of `sweep-sah`: the records sorted by centroid on each axis. A range has the same place in each."""

    x: np.ndarray  # (n, 8) float32
    y: np.ndarray  # (n, 8) float32
    z: np.ndarray  # (n, 8) float32


class SweptSource(NamedTuple):
    """Pointers of `Swept`."""

    records: F32Ptr  # float32 *, in the order of x
    y: F32Ptr  # float32 *
    z: F32Ptr  # float32 *
    scratch: F32Ptr  # float32 *, 8 for each record of a range


@inlined
def _order(source, axis):
    """The records, sorted on an axis."""
    return source.records if axis == 0 else source.y if axis == 1 else source.z


@inlined
def _centroid(records, i, axis):
    return get(records, i * 8 + axis) - get(records, i * 8 + axis + 4)


@kernel
def _sweep(records, first, last, axis, scale, right, best):
    """The cheaper of `best` and the best split of a range, sorted on `axis`."""
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
    """Move the records before (centroid, index) on `axis` to the front. Both sides keep their order."""
    # In: first, last; axis, centroid, index: the first right record's axis, double centroid and index word
    # Out: records, float32 *, reordered
    # Scratch: scratch, float32 *, 8 for each record
    ids = as_i32(records)
    left, right = first, np.int64(0)
    for i in range(first, last):
        record, c = load8(records, i * 8), _centroid(records, i, axis)
        goes_left = c < centroid or (c == centroid and get(ids, i * 8 + 3) < index)
        store(records, left * 8, record)  # overwrites only moved records; both stores are made each time
        store(scratch, right * 8, record)
        left += np.int64(goes_left)
        right += np.int64(not goes_left)
    for i in range(right):
        store(records, (left + i) * 8, load8(scratch, i * 8))


@overload(source_of)
def _source_of(method, depth, scratch):
    if method.instance_class is Swept:
        return lambda method, depth, scratch: SweptSource(ptr(method.x), ptr(method.y), ptr(method.z), scratch)


@overload(find_split)
def _find_split(source, first, last, centroids, depth, scale):
    if source.instance_class is SweptSource:

        def find(source, first, last, centroids, depth, scale):
            best = no_split()
            if must_halve(last - first, depth) or width(centroids) == 0:
                return best
            for axis in range(3):
                best = _sweep(_order(source, axis), first, last, axis, scale, source.scratch, best)
            return best

        return find


@overload(divide)
def _divide(source, first, last, centroids, split):
    if source.instance_class is SweptSource:

        def cut(source, first, last, centroids, split):
            axis, middle = max(split.axis, np.int64(0)), split.place
            if split.axis < 0:
                middle = (first + last) >> 1
            records = _order(source, axis)
            centroid, index = _centroid(records, middle, axis), get(as_i32(records), middle * 8 + 3)
            for other in range(3):
                if other != axis:
                    _divide_order(_order(source, other), first, last, axis, centroid, index, source.scratch)
            return middle

        return cut
