"""Pairs of points on surfaces of which one lies below the other's horizon, so that no ray needs to be traced.

Heights are those of `query.shadow_query.is_above` for receivers without triangles, so tracers find the same pairs.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...kernels.jit import inlined, kernel
from ...kernels.parallel import items, new_ticket, run, thread_count
from ...kernels.simd import bits, get, load16, ptr, put, stack_i32
from ...query.receivers import FREE, Receivers
from ..tables.bit_matrices import WORD, words_of

_LANES = 16


class Horizons(NamedTuple):
    """The ends of sightlines, with the planes below which they see nothing."""

    ends: np.ndarray  # (3, n) float64
    normals: np.ndarray  # (3, n) float64, towards the visible side; zeros in free space
    levels: np.ndarray  # (n,) float64: what the product of a normal and a vector must exceed; -1 in free space


def _horizons_of(points: Receivers, padding: int = 1) -> Horizons:
    """The `Horizons` of points, padded by zeros to a multiple of `padding`."""
    wide = -(-points.n // padding) * padding
    ends, normals, levels = np.zeros((3, wide)), np.zeros((3, wide)), np.full(wide, -1.0)
    ends[:, : points.n] = points.origins[0].T
    if points.normals.size:
        sided = points.sides[0] != FREE
        normals[:, : points.n][:, sided] = points.normals[0, sided].T
        levels[: points.n][sided] = 0.0
    return Horizons(ends, normals, levels)


@inlined
def _mark_hidden(rows, columns, i, first, flags):
    """Write to `flags` (int32) whether row i and each of WORD columns from `first` on hide each other."""
    n, m = len(rows.levels), len(columns.levels)
    ends, normals, heights = ptr(columns.ends), ptr(columns.normals), ptr(columns.levels)
    x, y, z = get(ptr(rows.ends), i), get(ptr(rows.ends), n + i), get(ptr(rows.ends), 2 * n + i)
    nx, ny, nz = get(ptr(rows.normals), i), get(ptr(rows.normals), n + i), get(ptr(rows.normals), 2 * n + i)
    level = get(ptr(rows.levels), i)
    for k in range(WORD):
        j = first + k
        dx, dy, dz = get(ends, j) - x, get(ends, m + j) - y, get(ends, 2 * m + j) - z
        up = dx * nx + dy * ny + dz * nz
        down = dx * get(normals, j) + dy * get(normals, m + j) + dz * get(normals, 2 * m + j)
        put(flags, k, np.int32(up <= level) | np.int32(-down <= get(heights, j)))


@kernel
def _hide(ticket, rows, columns, out):
    """Worker: set the bits of the columns that are hidden from each row."""
    flags, target, words = stack_i32(WORD), ptr(out), out.shape[1]
    for i in items(ticket):
        for w in range(words):
            _mark_hidden(rows, columns, i, w * WORD, flags)
            word = np.uint64(0)
            for k in range(0, WORD, _LANES):
                word |= np.uint64(bits(load16(flags, k) != np.int32(0))) << np.uint64(k)
            put(target, i * words + w, word)


def hidden_by_horizons(rows: Receivers, columns: Receivers, threads: int | None = None) -> NDArray[np.uint64]:
    """(n, words of m) uint64: bit j of row i is set where one of the points i and j is not above the other's horizon.

    Bits beyond the last column have any value.
    """
    out = np.empty((rows.n, words_of(columns.n)), np.uint64)
    arrays = _horizons_of(rows), _horizons_of(columns, WORD), out
    run(_hide, thread_count(threads), new_ticket(rows.n, 64), *arrays)
    return out
