"""A triangle against the rays of a leaf, 16 side by side: float32 decides beyond its error bounds, else exact code."""

import numpy as np

from ..jit import inlined, kernel
from ..predicate.exact import segment
from ..simd import atomic_or, bits, gather, get, lowest_bit, maximum, ptr_at
from ..trace.counters import TRIANGLE_TESTS, count
from ..trace.raytest import decide, length1, seen_from, triangle_in
from ..trace.traverse import settle
from ..trace.vec import minus, rows
from .rays import everyone, origins_of, receivers_of


@kernel
def _settled(leaves, leaf, ends, corners, slot, facing, unsure, counters):
    """Bits of those lanes that the triangle blocks, of those that float32 could not decide."""
    blocked = np.int64(0)
    while unsure != 0:
        lane = lowest_bit(unsure)
        unsure &= unsure - 1
        o, ways = ptr_at(leaves.origins, 3 * np.int64(get(leaves.ids, leaf * leaves.ways + lane))), leaves.ways
        end = ptr_at(ends, lane)
        ray = segment(get(o, 0), get(o, 1), get(o, 2), get(end, 0), get(end, ways), get(end, 2 * ways))
        side = settle(ray, corners, slot, counters)
        if side != 0 and side != facing:
            blocked |= np.int64(1) << lane
    return blocked


@inlined
def _span(leaves, ends, origins):
    """At least the sum of the components of each lane's segments."""
    span = length1(minus(rows(ends, 0, leaves.ways), origins))
    for s in range(1, leaves.count):
        span = maximum(span, length1(minus(rows(ends, 3 * s * leaves.ways, leaves.ways), origins)))
    return span


@kernel
def block_rays(leaves, leaf, corners, slot, prim, facing, counters):
    """Mark the segments of a leaf that the triangle in `slot` blocks as dead; are all of them dead now?

    prim : which triangle it is, which does not block the receivers on it
    """
    ways = leaves.ways
    there, _ = receivers_of(leaves, leaf)
    own = bits(gather(leaves.faces, there) == np.int32(prim))
    origins = origins_of(leaves, there)
    ends = ptr_at(leaves.ends, leaf * leaves.end_step)
    lanes = seen_from(origins, _span(leaves, ends, origins), triangle_in(corners, slot))
    finished = True
    for s in range(leaves.count):
        dead = np.int64(get(leaves.dead, leaf * leaves.count + s))
        asks = everyone(leaves) & ~dead
        if asks == 0:
            continue
        finished = False
        if asks & ~own == 0:
            continue
        count(counters, TRIANGLE_TESTS, 1)
        points = ptr_at(ends, 3 * s * ways)
        hit, unsure = decide(minus(rows(points, 0, ways), origins), lanes, facing)
        hit &= asks & ~own
        unsure &= asks & ~own
        if unsure != 0:
            hit |= _settled(leaves, leaf, points, corners, slot, facing, unsure, counters)
        if hit != 0:
            atomic_or(leaves.dead, leaf * leaves.count + s, hit)
    return finished
