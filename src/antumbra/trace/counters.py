"""Counters of tracing. Each thread counts in its own memory.

Most tracers always count, whether or not the caller asks, so that they are compiled only once. It costs them next to
nothing. If a kernel gets None as counters, counting is compiled away.
"""

import numpy as np

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
"""Names, in the order of the array:

- rays of the query; rays that their receiver's own surface blocks
- inner nodes visited; boxes tested; triangles tested
- tests that float32 left to float64; tests that float64 left to exact arithmetic
- rays blocked by the triangle that blocked the ray before

Tracers of many rays at once also count:

- triangles fetched; candidates: triangles left after whole bundles were culled; lanes that one triangle covers whole
- frusta shrunk to the rays that are left; tiles traced in tile groups; strata of tile groups tested against a block
- strata of them that were tested fan by fan

Ray hierarchies count a node each time that a triangle is tested against it. Candidates are those of these pairs that
may meet.

Any-hit rays of `single` count a node's boxes one by one, when the walk comes to them. Other walks count both boxes of a
node, or all eight. Tracers of many rays count a test of up to 16 lanes against one box or triangle once.
"""

RAYS, BELOW_HORIZON, NODES, BOX_TESTS, TRIANGLE_TESTS, UNCERTAIN, EXACT, REPEAT_HITS = range(8)
TRIANGLES, CANDIDATES, COVERED, SHRINKS, TILE_GROUP_TILES, GROUP_STRATA, FAN_STRATA = range(8, len(COUNTERS))
N_COUNTERS = len(COUNTERS)


def new_counters() -> np.ndarray:
    """An array of zeros, one for each counter."""
    return np.zeros(len(COUNTERS), np.int64)


def as_dict(counters: np.ndarray) -> dict[str, int]:
    """The counters by name, for people."""
    return dict(zip(COUNTERS, counters.tolist()))


@inlined
def cleared(mine):
    """Zero a thread's own counters, a kernel's ``stack_i64(N_COUNTERS)``, so that threads share no cache lines."""
    for i in range(N_COUNTERS):
        put(mine, i, 0)
    return mine


def cleared_if(counters, mine):
    """In kernels: `cleared`, or None if `counters` is None."""
    raise NotImplementedError


@overload(cleared_if)
def _cleared_if(counters, mine):
    if str(counters) == "none":  # decided at compile time: an optional argument would be tested at each count
        return lambda counters, mine: None
    return lambda counters, mine: cleared(mine)


@kernel
def add_counters(counters, mine):
    """Add a thread's counts to the shared ones, if there are any."""
    if counters is not None:
        for i in range(len(counters)):
            atomic_add(counters, i, get(mine, i))


@kernel
def count(counters, which, n):
    """Add n to one counter of this thread."""
    if counters is not None:
        put(counters, which, get(counters, which) + n)
