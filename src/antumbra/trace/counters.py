"""What tracing counts. Counting is compiled away when nobody asked for it."""

import numpy as np
from numba.core import types
from numba.extending import overload

from ..jit import kernel
from ..simd import atomic_add, get, ptr, put

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
blocked whole; frusta shrunk to the rays that are left; tiles traced in sheaves."""

RAYS, BELOW_HORIZON, NODES, BOX_TESTS, TRIANGLE_TESTS, UNCERTAIN, EXACT, REPEAT_HITS = range(8)
TRIANGLES, CANDIDATES, COVERED, SHRINKS, SHEAF_TILES = range(8, len(COUNTERS))


def new_counters(wanted: bool) -> np.ndarray | None:
    """An array of zeros, one a counter, or None, which compiles the counting away."""
    return np.zeros(len(COUNTERS), np.int64) if wanted else None


def as_dict(counters: np.ndarray | None) -> dict[str, int] | None:
    """Names and values, for people."""
    return None if counters is None else dict(zip(COUNTERS, counters.tolist()))


def private_counters(counters):
    """In kernels: a thread's own zeros (None when nothing is counted), so that threads do not share cache lines."""
    raise NotImplementedError


def pointer_to(mine):
    """In kernels: private counters for those called often: an array that is passed on costs a reference count."""
    raise NotImplementedError


@overload(private_counters)
def _private_counters(counters):
    if isinstance(counters, types.NoneType):  # told apart here: what might be None is tested for it each time
        return lambda counters: None
    return lambda counters: np.zeros_like(counters)


@overload(pointer_to)
def _pointer_to(mine):
    if isinstance(mine, types.NoneType):
        return lambda mine: None
    return lambda mine: ptr(mine)


@kernel
def add_counters(counters, mine):
    """Add a thread's counts to the shared ones."""
    if counters is not None:
        for i in range(len(mine)):
            atomic_add(counters, i, mine[i])


@kernel
def count(counters, which, n):
    """Add n to one counter of this thread."""
    if counters is not None:
        put(counters, which, get(counters, which) + n)
