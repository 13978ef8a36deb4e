"""`sweep-sah`: a top-down builder by the full sweep SAH [MacDonald and Booth 1990], as in [Wald 2007, Sec. 3].

It builds as `bsah` does, but splits a range at the best of all places between two centroids (`sweep`). In the first
levels, one thread splits a range.
"""

import numpy as np

from ..kernels.jit import kernel
from ..kernels.parallel import items, new_ticket, run, thread_count
from ..kernels.simd import load8, ptr, store
from .assemble import assemble
from .bounds import range_bounds
from .nodes import Bvh, aligned_empty
from .prepare import checked, make_records, power_of_two_for, tiny
from .radix_sort import radix_sort
from .splits import divide, find_split, source_of
from .subtree import Settings
from .sweep import SWEEP_WORDS, Swept
from .top import build_top
from .top_down import build_below, largest_subtree


def _in_order(records, axis: int, threads: int):
    """The records sorted by their centroids on an axis. Equal centroids are ordered by index."""
    bits = (records[:, axis] - records[:, axis + 4] + np.float32(0.0)).view(np.int32)  # -0 becomes +0
    keys = bits ^ ((bits >> 31) | np.int32(-(2**31)))  # as unsigned numbers, these have the floats' order
    order = radix_sort(keys, np.arange(len(records), dtype=np.int32), 32, threads)[1]
    out = aligned_empty(records.shape, "f4")
    return np.take(records, order, axis=0, out=out)


@kernel
def _split_ranges(ticket, method, ranges, boxes, depth, scale, middles, sides, scratch):
    """Worker: split ranges, and bound both sides of each."""
    # In: method, `Swept`; ranges, (k, 2) first and last record; boxes, (k, 16); depth; scale
    # Out: middles, (k,) first right record; sides, (k, 32) box and centroid box of both sides
    # Scratch: scratch, the thread's own memory for `source_of`
    for r in items(ticket):
        first, last = ranges[r]
        source, centroids = source_of(method, depth, ptr(scratch)), load8(boxes, r * 16 + 8)
        split = find_split(source, first, last, centroids, depth, scale)
        middle = divide(source, first, last, centroids, split)
        left, left_centroids = range_bounds(source.records, first, middle)
        right, right_centroids = range_bounds(source.records, middle, last)
        store(sides, r * 32, left)
        store(sides, r * 32 + 8, left_centroids)
        store(sides, r * 32 + 16, right)
        store(sides, r * 32 + 24, right_centroids)
        middles[r] = middle


def _split_by_sweep(method: Swept, scale, threads: int):
    """The `split_level` for `build_top` in which one thread splits a range."""

    def split_level(ranges, boxes, depth):
        k, words = len(ranges), SWEEP_WORDS * int((ranges[:, 1] - ranges[:, 0]).max())
        middles, sides = np.empty(k, np.int64), np.empty((k, 32), np.float32)
        own = lambda: (np.empty(words, np.float32),)
        run(_split_ranges, threads, new_ticket(k, 1), method, ranges, boxes, depth, scale, middles, sides, own=own)
        return middles, sides

    return split_level


def build(vertices: np.ndarray, threads: int | None = None, max_leaf: int = 4) -> Bvh:
    """Build a BVH by the full sweep SAH; the same, bit for bit, for any number of threads.

    Parameters, errors and the result are as for `binned_sah.build`.
    """
    flat, threads = checked(vertices, max_leaf), thread_count(threads)
    n = len(flat)
    records = aligned_empty((n, 8), "f4")
    box, centroids = make_records(flat, records, threads)
    if n < 2:
        return tiny(flat)
    method = Swept(*(_in_order(records, axis, threads) for axis in range(3)))
    settings = Settings(np.int64(max_leaf), power_of_two_for(box))
    top = build_top(n, box, centroids, largest_subtree(n), _split_by_sweep(method, settings.scale, threads))
    bvh, subtrees = build_below(flat, method, SWEEP_WORDS * largest_subtree(n), top, settings, threads)
    del method, records  # room for the final nodes
    return assemble(bvh, top, subtrees, threads)
