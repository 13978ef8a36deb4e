"""What tracing counts: each thread in memory of its own. Most tracers always count, whether anybody asks or not, so
that they are compiled once: it costs them next to nothing. Where None is passed on, counting is compiled away."""

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
    "sheaf_tiles",
)
"""Names, in the order of the array: rays asked; those that their own surface settled; inner nodes visited; boxes
tested; triangles tested; tests that float32 left to float64; tests that float64 left to exact arithmetic; rays blocked
by the triangle that blocked the ray before. Any-hit of `single` counts a node's boxes one by one, when it comes to
them; others both of a node, or all eight. Tracers of many rays at once count a test of up to 16 lanes against one box
or triangle once, and besides: triangles fetched; those left when whole bundles had been culled; lanes that one triangle
blocked whole; frusta shrunk to the rays that are left; tiles traced in tile groups."""

RAYS, BELOW_HORIZON, NODES, BOX_TESTS, TRIANGLE_TESTS, UNCERTAIN, EXACT, REPEAT_HITS = range(8)
TRIANGLES, CANDIDATES, COVERED, SHRINKS, TILE_GROUP_TILES = range(8, len(COUNTERS))
N_COUNTERS = len(COUNTERS)


def new_counters() -> np.ndarray:
    """An array of zeros, one a counter."""
    return np.zeros(len(COUNTERS), np.int64)


def as_dict(counters: np.ndarray) -> dict[str, int]:
    """Names and values, for people."""
    return dict(zip(COUNTERS, counters.tolist()))


@inlined
def cleared(mine):
    """A thread's own zeros, so that threads do not share cache lines: a kernel's ``stack_i64(N_COUNTERS)``."""
    for i in range(N_COUNTERS):
        put(mine, i, 0)
    return mine


def cleared_if(counters, mine):
    """In kernels: `cleared`, or None if `counters` is None."""
    raise NotImplementedError


@overload(cleared_if)
def _cleared_if(counters, mine):
    if str(counters) == "none":  # told apart here: what might be None is tested for it each time
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
