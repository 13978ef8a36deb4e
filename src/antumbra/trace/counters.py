"""Tracing counters. Each thread counts in its own memory.

Most tracers always count, even if the caller passes no counters, so that they are compiled only once; this costs next
to nothing. Counting is compiled away if a kernel gets None as counters.
"""

import numpy as np
from numpy.typing import NDArray

from ..kernels.jit import inlined, kernel, overload
from ..kernels.simd import atomic_add, get, put

COUNTERS = (
    "rays",
    "below_horizon",
    "nodes",
    "box_tests",
    "triangle_tests",
    "uncertain",
    "exact",
    "repeat_hits",
    "triangles",
    "candidates",
    "covered",
    "shrinks",
    "group_tiles",
    "group_strata",
    "fan_strata",
)
"""Counter names, in the order of the array:

- rays of the query, one for all equal samples of a receiver; rays that their receiver's own surface blocks
- inner nodes visited; boxes tested; triangles tested
- tests undecided in float32, repeated in float64 unless the ray misses the triangle's bounds; tests undecided in
  float64, repeated in exact arithmetic
- rays blocked by the same triangle as the previous ray

Tracers of many rays at once also count:

- triangles fetched; candidates: triangles left after bundle culling; lanes that one triangle covers completely
- frusta shrunk to their unblocked rays; tiles traced in tile groups; strata of tile groups tested against a block
- those of these strata that were tested by reverse frusta

Ray hierarchies count a node each time a triangle is tested against it; candidates are the pairs that may meet.

Any-hit rays of `single` count the boxes of a node one by one, when the traversal reaches them. Other traversals count
both boxes of a node, or all eight. Tracers of many rays count one test of up to 16 lanes against a box or triangle
once.
"""

RAYS, BELOW_HORIZON, NODES, BOX_TESTS, TRIANGLE_TESTS, UNCERTAIN, EXACT, REPEAT_HITS = range(8)
TRIANGLES, CANDIDATES, COVERED, SHRINKS, TILE_GROUP_TILES, GROUP_STRATA, FAN_STRATA = range(8, len(COUNTERS))
N_COUNTERS = len(COUNTERS)


def new_counters() -> NDArray[np.int64]:
    """Zeros, one per counter."""
    return np.zeros(len(COUNTERS), np.int64)


def as_dict(counters: NDArray[np.int64]) -> dict[str, int]:
    """Counts by name."""
    return dict(zip(COUNTERS, counters.tolist()))


@inlined
def cleared(mine):
    """Zero a thread's counters: a kernel's own ``stack_i64(N_COUNTERS)``, so that threads share no cache lines."""
    for i in range(N_COUNTERS):
        put(mine, i, 0)
    return mine


def cleared_if(counters, mine):
    """In kernels: `cleared`, or None if `counters` is None."""
    raise NotImplementedError


@overload(cleared_if)
def _cleared_if(counters, mine):
    if str(counters) == "none":  # decided at compile time; an optional argument would be tested at each count
        return lambda counters, mine: None
    return lambda counters, mine: cleared(mine)


@kernel
def add_counters(counters, mine):
    """Add a thread's counts to the shared counters, unless they are None."""
    if counters is not None:
        for i in range(len(counters)):
            atomic_add(counters, i, get(mine, i))


@kernel
def count(counters, which, n):
    """Add n to one counter of this thread."""
    if counters is not None:
        put(counters, which, get(counters, which) + n)
