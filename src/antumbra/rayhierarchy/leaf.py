"""Test of a triangle against the rays of a leaf, 16 at once: in float32, or exactly within its error bounds."""

import numpy as np

from ..kernels.jit import inlined, kernel
from ..kernels.predicate.exact import segment
from ..kernels.simd import atomic_or, bits, get, load16, lowest_bit, maximum, ptr_at
from ..kernels.vec import minus, rows
from ..trace.counters import TRIANGLE_TESTS, count
from ..trace.rays.ray_traversal import settle
from ..trace.triangle_tests import decide, length1, seen_from
from .rays import block_of, ends_in, origins_in


@kernel
def _settled(leaves, block, ends, corners, slot, facing, unsure, counters):
    """Bits of the `unsure` lanes that the triangle blocks. Float32 could not decide these, so the test is exact."""
    blocked, o = np.int64(0), ptr_at(leaves.origins, 3 * block * leaves.ways)
    while unsure != 0:
        lane = lowest_bit(unsure)
        unsure &= unsure - 1
        ray = segment(
            get(o, lane), get(o, leaves.ways + lane), get(o, 2 * leaves.ways + lane),
            get(ends, lane), get(ends, leaves.ways + lane), get(ends, 2 * leaves.ways + lane),
        )  # fmt: skip
        side = settle(ray, corners, slot, counters)
        if side != 0 and side != facing:
            blocked |= np.int64(1) << lane
    return blocked


@inlined
def _span(leaves, ends, origins):
    """Upper bound of the 1-norm of each lane's segments."""
    span = length1(minus(rows(ends, 0, leaves.ways), origins))
    for s in range(1, leaves.count):
        span = maximum(span, length1(minus(rows(ends, 3 * s * leaves.ways, leaves.ways), origins)))
    return span


@kernel
def block_rays(leaves, leaf, corners, slot, triangle, prim, facing, counters):
    """Mark the segments of a leaf that the triangle in `slot` blocks as dead; True if all of them are dead now.

    triangle : the result of `triangle_in`
    prim : the triangle's id; it does not block receivers that lie on it
    """
    ways, block, everyone = leaves.ways, block_of(leaves, leaf), (np.int64(1) << leaves.ways) - 1
    marks, first = ptr_at(leaves.dead, leaf * leaves.count), np.int64(0)
    while first < leaves.count and np.int64(get(marks, first)) == everyone:
        first += 1
    if first == leaves.count:
        return True
    origins, ends = origins_in(leaves, block), ends_in(leaves, leaf, block)
    lanes, finished = seen_from(origins, _span(leaves, ends, origins), triangle), True
    for s in range(first, leaves.count):
        asks = everyone & ~np.int64(get(marks, s))
        if asks == 0:
            continue
        count(counters, TRIANGLE_TESTS, 1)
        points = ptr_at(ends, 3 * s * ways)
        hit, unsure = decide(minus(rows(points, 0, ways), origins), lanes, facing)
        if (hit | unsure) & asks != 0:
            others = ~bits(load16(leaves.own, block * ways) == np.int32(prim))
            hit, unsure = hit & asks & others, unsure & asks & others
            if unsure != 0:
                hit |= _settled(leaves, block, points, corners, slot, facing, unsure, counters)
            if hit != 0:
                atomic_or(leaves.dead, leaf * leaves.count + s, hit)
                asks &= ~hit
        finished = finished and asks == 0
    return finished
