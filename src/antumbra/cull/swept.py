"""Marks the cells between sources and targets [Selgrad et al. 2015, Sec. 3.2], one layer of the grid at a time.

The paper walks along the line between the centres of every source cell and every destination cell. It marks each cell
on the line and all its neighbours. This module marks the convex hull of a source box S and a target box T itself.

The hull is the union of the boxes B(t) = (1 - t) S + t T, 0 <= t <= 1 (equation 1 of docs/design/culling.md). Their
bounds are linear in t. So the hull's part in a layer of cells lies in a rectangle, and two values of t bound it. Adding
a rectangle to the layer's table of differences takes four additions, however many cells it has.
"""

from typing import NamedTuple

import numpy as np

from ..kernels.fields import F64Ptr
from ..kernels.jit import inlined, kernel
from ..kernels.parallel import items, new_ticket, run
from ..kernels.simd import get, ptr, put
from .grid import PAD, cell_at, pointers_of

_SOURCES = 8192  # boxes of receivers whose pairs are in memory at the same time


class Hulls(NamedTuple):
    """Pairs of a source box S and a target box T, sorted by their main axis.

    The main axis is the one along which S and T are the most cells apart.
    """

    lower: np.ndarray  # (m, 3) float64: lower corner of S
    upper: np.ndarray  # (m, 3) float64: upper corner of S
    grow: np.ndarray  # (m, 3) float64: lower corner of T minus lower corner of S; B(t) begins at lower + t grow
    swell: np.ndarray  # (m, 3) float64: upper corner of T minus upper corner of S; B(t) ends at upper + t swell
    start: np.ndarray  # (4,) int64: pairs start[k] to start[k + 1] - 1 have the main axis k


def hulls_between(sources: np.ndarray, targets, grid) -> Hulls:
    """The `Hulls` of all pairs of (m, 2, 3) source boxes and `Targets`.

    Equations 1 and 5 of docs/design/culling.md.
    """
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
    """Pointers to the arrays of `Hulls`. The arrays must outlive them. Arrays would cost reference counts."""

    lower: F64Ptr  # float64 *, 3 for each pair, as are the others
    upper: F64Ptr  # float64 *
    grow: F64Ptr  # float64 *
    swell: F64Ptr  # float64 *


@inlined
def _while_at_least(start, slope, limit, low, high):
    """The part of [low, high] where start + t slope >= limit, as (low, high); empty if low > high."""
    if slope == 0.0:
        return (low, high) if start >= limit else (np.float64(1.0), np.float64(0.0))
    t = (limit - start) / slope
    return (max(low, t), high) if slope > 0.0 else (low, min(high, t))


@inlined
def _while_within(bounds, k, near, far):
    """(low, high): the t in [0, 1] for which B(t) meets the slab from `near` to `far`; empty if low > high.

    `k` is the index of the pair and the axis in the arrays. Equation 3 of docs/design/culling.md.
    """
    low, high = np.float64(0.0), np.float64(1.0)
    low, high = _while_at_least(get(bounds.upper, k), get(bounds.swell, k), near, low, high)
    return _while_at_least(-get(bounds.lower, k), -get(bounds.grow, k), -far, low, high)


@inlined
def _cells_between(bounds, k, axis, low, high, pad, grid):
    """First and last cell along an axis that B(t) overlaps for t in [low, high].

    `k` is the index of the pair and the axis in the arrays. Equation 4 of docs/design/culling.md.
    """
    a, b = get(bounds.lower, k), get(bounds.upper, k)
    least = min(a + low * get(bounds.grow, k), a + high * get(bounds.grow, k)) - pad
    most = max(b + low * get(bounds.swell, k), b + high * get(bounds.swell, k)) + pad
    return cell_at(grid, axis, np.float32(least)), cell_at(grid, axis, np.float32(most))


@inlined
def _add(table, place, x):
    put(table, place, get(table, place) + np.int32(x))


@inlined
def _add_rectangle(table, side, first_u, last_u, first_v, last_v):
    """Add 1 to a rectangle of cells, by its differences in the table, which has `side` numbers a row."""
    _add(table, first_u * side + first_v, 1)
    _add(table, (last_u + 1) * side + first_v, -1)
    _add(table, first_u * side + last_v + 1, -1)
    _add(table, (last_u + 1) * side + last_v + 1, 1)


@inlined
def _walls(grid, axis, layer, pad):
    """(near, far): the coordinates that bound the points of a layer. Outermost layers have no outer wall."""
    size = 1.0 / np.float64(grid.scale[axis]) if grid.scale[axis] > 0.0 else np.inf
    near = grid.bounds[0, axis] + layer * size - pad if layer > 0 else -np.inf
    far = grid.bounds[0, axis] + (layer + 1) * size + pad if layer < grid.n - 1 else np.inf
    return near, far


@kernel
def _mark_layers(ticket, hulls, grid, pad, marked, table):
    """Worker: mark the cells of one layer after the other, along each axis in turn.

    table : (n + 1, n + 1) int32, the thread's own memory
    """
    n = grid.n
    bounds = _Bounds(ptr(hulls.lower), ptr(hulls.upper), ptr(hulls.grow), ptr(hulls.swell))
    known = pointers_of(grid)
    for item in items(ticket):
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


@inlined
def _mark_sums(table, axis, layer, marked):
    """Sum the table's differences, and mark the cells of the layer where the sum is not zero."""
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

    One thread marks a layer. Another thread can write the same cell for another axis only, and it also writes 1. So the
    order does not matter, as in the paper.
    """
    pad = np.float64(PAD * np.abs(grid.bounds).max())
    own = lambda: (np.empty((grid.n + 1, grid.n + 1), np.int32),)
    for first in range(0, len(sources), _SOURCES):
        hulls = hulls_between(sources[first : first + _SOURCES], targets, grid)
        run(_mark_layers, threads, new_ticket(3 * grid.n, 1), hulls, grid, pad, marked, own=own)
