"""Bounds of a query's triangles and points; distant lights are placed beyond them."""

from math import sqrt

import numpy as np

from ..kernels.jit import kernel
from ..kernels.parallel import CHUNK, new_ticket, run, shares, thread_count
from ..kernels.simd import load16, maximum, minimum, ptr, splat16, store

_ROWS = 16  # points per block: three vectors of 16 lanes; a lane holds the same axis in every block
_BLOCK = 3 * _ROWS
_CHUNK = 2048  # blocks
_TINY = float(np.finfo(np.float32).tiny)


@kernel
def _bounds(ticket, values, parts):
    """Worker: minimum and maximum at each of the 48 positions in a block, for each chunk of blocks."""
    p, out = ptr(values), ptr(parts)
    for first, last in shares(ticket):
        a, b, c = (splat16(np.float32(np.inf)), splat16(np.float32(np.inf)), splat16(np.float32(np.inf)))
        d, e, f = (splat16(np.float32(-np.inf)), splat16(np.float32(-np.inf)), splat16(np.float32(-np.inf)))
        for i in range(first, last):
            x, y, z = load16(p, _BLOCK * i), load16(p, _BLOCK * i + 16), load16(p, _BLOCK * i + 32)
            a, b, c = minimum(a, x), minimum(b, y), minimum(c, z)
            d, e, f = maximum(d, x), maximum(e, y), maximum(f, z)
        row = first // ticket[CHUNK] * 2 * _BLOCK
        store(out, row, a)
        store(out, row + 16, b)
        store(out, row + 32, c)
        store(out, row + 48, d)
        store(out, row + 64, e)
        store(out, row + 80, f)


def bounds(points: np.ndarray, threads: int | None = None) -> tuple[np.ndarray, np.ndarray]:
    """Lower and upper corner, (3,) float32 each, of at least one (..., 3) float32 point; C-contiguous and finite."""
    flat = points.reshape(-1)
    n = flat.size // _BLOCK
    if n == 0:
        rest = flat.reshape(-1, 3)
        if len(rest) == 1:
            return rest[0], rest[0]
        return rest.min(0), rest.max(0)
    parts = np.empty((-(-n // _CHUNK), 2, _ROWS, 3), np.float32)
    run(_bounds, thread_count(threads), new_ticket(n, _CHUNK), flat, parts)
    rest = flat[n * _BLOCK :].reshape(-1, 3)
    lower, upper = parts[:, 0].reshape(-1, 3), parts[:, 1].reshape(-1, 3)
    return np.concatenate([lower, rest]).min(0), np.concatenate([upper, rest]).max(0)


def reach(triangles, points: np.ndarray, threads: int | None = None) -> float:
    """A length greater than the distance from any of the (..., 3) points to any triangle's corner."""
    return reach_of(np.stack(bounds(triangles.vertices, threads)), points, threads)


def reach_of(box: np.ndarray, points: np.ndarray | None = None, threads: int | None = None) -> float:
    """As `reach`, from the exact bounds of the triangles.

    box : (2, 3) float32
    points : (..., 3) float32 or None; None: they lie on the triangles
    """
    lower, upper = box
    if points is not None:
        low, high = bounds(points, threads)
        lower, upper = np.minimum(lower, low), np.maximum(upper, high)
    across = upper.astype(np.float64) - lower
    return 2.0 * sqrt(across.dot(across)) + _TINY
