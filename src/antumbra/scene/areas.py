"""Triangles without area. No ray meets them, so no tree holds them (docs/design/exactness.md)."""

import numpy as np

from ..kernels.jit import kernel
from ..kernels.parallel import items, new_ticket, run, shares, thread_count
from ..kernels.predicate.filters import has_area
from ..kernels.simd import get, load8, ptr, put, store
from .triangles import Triangles

_AT_A_TIME = 8192  # triangles


@kernel
def _find_areas(ticket, corners, found, faults):
    """Worker: whether each triangle has an area."""
    # Out: found, (n,) bool; faults, (1,) bool, set if a triangle has none
    v = ptr(corners)
    for first, last in shares(ticket):
        all_have = True
        for i in range(first, last):
            has = has_area(v, i)
            found[i] = has
            all_have &= has
        if not all_have:
            faults[0] = True


def with_area(vertices: np.ndarray, threads: int) -> np.ndarray | None:
    """(k,) int32, ascending: the triangles that have an area, by exact arithmetic; None: all have.

    vertices : (n, 3, 3) float32
    """
    found, faults = np.empty(len(vertices), np.bool_), np.zeros(1, np.bool_)
    run(_find_areas, threads, new_ticket(len(vertices), _AT_A_TIME), vertices.reshape(-1, 9), found, faults)
    return np.flatnonzero(found).astype(np.int32) if faults[0] else None


@kernel
def _copy_rows(ticket, corners, rows, out):
    """Worker: copy the corners of some triangles to the front of `out`."""
    source, target = ptr(corners), ptr(out)
    for i in items(ticket):
        row = np.int64(rows[i]) * 9
        store(target, i * 9, load8(source, row))
        put(target, i * 9 + 8, get(source, row + 8))


def solid_vertices(triangles: Triangles, threads: int | None) -> np.ndarray:
    """(k, 3, 3) float32: the triangles with an area and without a hole; without a copy if that is all of them."""
    if triangles.solid is None:
        return triangles.vertices
    out = np.empty((len(triangles.solid), 9), np.float32)
    ticket = new_ticket(len(out), _AT_A_TIME)
    run(_copy_rows, thread_count(threads), ticket, triangles.vertices.reshape(-1, 9), triangles.solid, out)
    return out.reshape(-1, 3, 3)


def solid_faces(vertices: np.ndarray, own: np.ndarray | None, threads: int) -> np.ndarray | None:
    """(k,) int32, ascending: the faces that have an area, among those without a hole; None: all faces.

    own : (m,) int32, ascending: the faces without a hole; None: all
    """
    found = with_area(vertices, threads)
    if found is None or own is None:
        return own if found is None else found
    return np.intersect1d(found, own, assume_unique=True)
