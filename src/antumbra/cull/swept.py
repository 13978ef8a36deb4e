"""Marks the cells between sources and targets [Selgrad et al. 2015, Sec. 3.2], all of a layer of the grid at once.

The paper walks from every source cell to every destination cell along the line between their middles, and marks each
cell it meets with all its neighbours. Here the convex hull of a source box S and a target box T itself is marked. It is
the union of the boxes B(t) = (1 - t) S + t T, 0 <= t <= 1, whose bounds are linear in t. So what it has in a layer of
cells lies in a rectangle that two values of t bound, and a rectangle is added to a layer in four places of its table
of differences, however many cells it has.
"""

from typing import NamedTuple

import numpy as np

from ..kernels.jit import inlined, kernel
from ..kernels.parallel import new_ticket, run, take
from ..kernels.simd import get, ptr, put
from .grid import PAD, cell_at, pointers_of

_SOURCES = 8192  # boxes of receivers whose pairs are held at once


class Hulls(NamedTuple):
    """Pairs of a source box S and a target box T, sorted by the axis along which they are the most cells apart."""

    lower: np.ndarray  # (m, 3) float64, of S
    upper: np.ndarray  # (m, 3) float64, of S
    grow: np.ndarray  # (m, 3) float64: lower corner of T minus that of S; that of B(t) is lower + t grow
    swell: np.ndarray  # (m, 3) float64: the same of the upper corners
    start: np.ndarray  # (4,) int64: pairs start[k] to start[k + 1] - 1 are for axis k


def hulls_between(sources: np.ndarray, targets, grid) -> Hulls:
    """The `Hulls` of all pairs of (m, 2, 3) source boxes and `Targets`."""
    s, t = sources[:, None], targets.boxes[None]
    t = s + t if targets.relative else np.broadcast_to(t, (len(s), *t.shape[1:]))
    grow, swell = t[:, :, 0] - s[:, :, 0], t[:, :, 1] - s[:, :, 1]
    axis = (np.abs(grow + swell) * grid.scale[:3]).argmax(-1).ravel()
    order, of = np.argsort(axis, kind="stable"), np.repeat(np.arange(len(s)), t.shape[1])
    return Hulls(
        sources[of[order], 0], sources[of[order], 1], grow.reshape(-1, 3)[order], swell.reshape(-1, 3)[order],
        np.searchsorted(axis[order], np.arange(4)),
    )  # fmt: skip


class _Bounds(NamedTuple):
    """Pointers to the arrays of `Hulls`, which must outlive them: arrays cost reference counts."""

    lower: object  # float64 *, 3 a pair
    upper: object
    grow: object
    swell: object


@inlined
def _while_at_least(start, slope, limit, low, high):
    """The part of [low, high] where start + t slope >= limit, as (low, high); empty if low > high."""
    if slope == 0.0:
        return (low, high) if start >= limit else (np.float64(1.0), np.float64(0.0))
    t = (limit - start) / slope
    return (max(low, t), high) if slope > 0.0 else (low, min(high, t))


@inlined
def _while_within(bounds, k, near, far):
    """The t between 0 and 1 for which B(t), on the axis of element k, meets the slab from `near` to `far`."""
    low, high = np.float64(0.0), np.float64(1.0)
    low, high = _while_at_least(get(bounds.upper, k), get(bounds.swell, k), near, low, high)
    return _while_at_least(-get(bounds.lower, k), -get(bounds.grow, k), -far, low, high)


@inlined
def _cells_between(bounds, k, axis, low, high, pad, grid):
    """First and last cell along an axis, that of element k, that B(t) has while t is between `low` and `high`."""
    a, b = get(bounds.lower, k), get(bounds.upper, k)
    least = min(a + low * get(bounds.grow, k), a + high * get(bounds.grow, k)) - pad
    most = max(b + low * get(bounds.swell, k), b + high * get(bounds.swell, k)) + pad
    return cell_at(grid, axis, np.float32(least)), cell_at(grid, axis, np.float32(most))


@inlined
def _add(table, place, x):
    put(table, place, get(table, place) + np.int32(x))


@inlined
def _add_rectangle(table, side, first_u, last_u, first_v, last_v):
    """Add 1 to the table, of so many cells a row, whose differences these are, from one cell to the other."""
    _add(table, first_u * side + first_v, 1)
    _add(table, (last_u + 1) * side + first_v, -1)
    _add(table, first_u * side + last_v + 1, -1)
    _add(table, (last_u + 1) * side + last_v + 1, 1)


@inlined
def _walls(grid, axis, layer, pad):
    """Between which coordinates all points lie that are in a layer; outermost layers have no outer wall."""
    size = 1.0 / np.float64(grid.scale[axis]) if grid.scale[axis] > 0.0 else np.inf
    near = grid.bounds[0, axis] + layer * size - pad if layer > 0 else -np.inf
    far = grid.bounds[0, axis] + (layer + 1) * size + pad if layer < grid.n - 1 else np.inf
    return near, far


@kernel
def _mark_layers(ticket, hulls, grid, pad, marked, table):
    """Worker: mark the cells of layer after layer of each axis in turn.

    table : the thread's own memory for (n + 1, n + 1) int32
    """
    n = grid.n
    bounds = _Bounds(ptr(hulls.lower), ptr(hulls.upper), ptr(hulls.grow), ptr(hulls.swell))
    known = pointers_of(grid)
    item = take(ticket)
    while item >= 0:
        axis, layer = item // n, item % n
        u, v = 1 - min(axis, 1), 2 - axis // 2
        near, far = _walls(grid, axis, layer, pad)
        table[:] = 0
        for i in range(hulls.start[axis], hulls.start[axis + 1]):
            low, high = _while_within(bounds, i * 3 + axis, near, far)
            if low <= high:
                u0, u1 = _cells_between(bounds, i * 3 + u, u, low, high, pad, known)
                v0, v1 = _cells_between(bounds, i * 3 + v, v, low, high, pad, known)
                _add_rectangle(ptr(table), n + 1, u0, u1, v0, v1)
        _mark_sums(table, axis, layer, marked)
        item = take(ticket)


@inlined
def _mark_sums(table, axis, layer, marked):
    """Mark the cells of a layer where the sums of the table's differences are not zero."""
    n = len(marked)
    for i in range(n):
        row = np.int32(0)
        for j in range(n):
            row += table[i, j]
            table[i, j] = row + (table[i - 1, j] if i > 0 else np.int32(0))
            if table[i, j] > 0:
                if axis == 0:
                    marked[layer, i, j] = 1
                elif axis == 1:
                    marked[i, layer, j] = 1
                else:
                    marked[i, j, layer] = 1


def mark_hulls(sources: np.ndarray, targets, grid, marked: np.ndarray, threads: int) -> None:
    """Set to 1 the cells of ``marked``, (n, n, n) uint8, that a segment from a source to a target can meet.

    A layer is one thread's, so a cell is only ever written by others in the pass for another axis, and then also to 1:
    the order does not matter, as the paper says of its cells.
    """
    pad = np.float64(PAD * np.abs(grid.bounds).max())
    own = lambda: (np.empty((grid.n + 1, grid.n + 1), np.int32),)
    for first in range(0, len(sources), _SOURCES):
        hulls = hulls_between(sources[first : first + _SOURCES], targets, grid)
        run(_mark_layers, threads, new_ticket(3 * grid.n, 1), hulls, grid, pad, marked, own=own)
