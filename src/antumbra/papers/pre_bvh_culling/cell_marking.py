"""Marks grid cells for pre-BVH culling: as published, and a convex region for comparison.

As published, cells are marked along lines between cells, with all their neighbours [Selgrad et al. 2015, Sec. 3.2]. The
convex region around receivers and light is what the paper's grid improves on (Fig. 2b).
"""

from itertools import product

import numpy as np

from ...kernels.jit import inlined, kernel
from ...kernels.parallel import items, new_ticket, run
from ...techniques.culling.culling_grid import PAD, cell_at

# --- Marks cells as published: along lines between cells, with all neighbours [Selgrad et al. 2015, Sec. 3.2] ---------
#
# The module walks a line from the centre of every source cell to the centre of every destination cell [Amanatides and
# Woo
# 1987]. It marks each cell on the line with its one-ring. This is conservative. Take a point of a segment between two
# cells, and the point of the line at the same parameter. They are at most half a cell apart on each axis.
#
# The module `techniques.culling.culling_grid` marks fewer cells in less time. This one serves for comparison.


def _cells_of(boxes: np.ndarray, grid) -> np.ndarray:
    """(m, 3) int64: the cells that (k, 2, 3) boxes overlap, without repetitions."""
    held = np.zeros((grid.n,) * 3, np.bool_)
    ranges = np.empty(boxes.shape, np.int64)
    _write_ranges(boxes.astype(np.float32), grid, ranges)
    for low, high in ranges:
        held[low[0] : high[0] + 1, low[1] : high[1] + 1, low[2] : high[2] + 1] = True
    return np.argwhere(held)


@kernel
def _write_ranges(boxes, grid, ranges):
    """Fill (k, 2, 3) int64: first and last cell of each box."""
    for i in range(len(boxes)):
        for end in range(2):
            for axis in range(3):
                ranges[i, end, axis] = cell_at(grid, axis, boxes[i, end, axis])


@inlined
def _first_crossing(a, b):
    """(step, t of the first wall, t between walls) on one axis, for the line between the centres of cells a and b."""
    if a == b:
        return np.int64(0), np.inf, np.inf
    between = 1.0 / np.float64(abs(b - a))
    return np.int64(1 if b > a else -1), 0.5 * between, between


@inlined
def _walk(ax, ay, az, bx, by, bz, met):
    """Mark the cells on the line from the centre of cell a to the centre of cell b."""
    sx, tx, dx = _first_crossing(ax, bx)
    sy, ty, dy = _first_crossing(ay, by)
    sz, tz, dz = _first_crossing(az, bz)
    met[ax, ay, az] = 1
    while min(tx, ty, tz) < 1.0:
        if tx <= ty and tx <= tz:
            ax, tx = ax + sx, tx + dx
        elif ty <= tz:
            ay, ty = ay + sy, ty + dy
        else:
            az, tz = az + sz, tz + dz
        met[ax, ay, az] = 1


@kernel
def _walk_all(ticket, sources, ends, met):
    """Worker: walk the lines from each source cell. All threads write 1, so their order does not matter."""
    for i in items(ticket):
        for k in range(len(ends)):
            _walk(sources[i, 0], sources[i, 1], sources[i, 2], ends[k, 0], ends[k, 1], ends[k, 2], met)


def mark_lines(sources: np.ndarray, targets, grid, marked: np.ndarray, threads: int) -> None:
    """Mark cells like `swept.mark_hulls`, for a grid that holds the targets too.

    The paper has no lights that move with the receiver. For such lights, all cells are marked.
    """
    if targets.relative:
        marked[:] = 1
        return
    starts, met = _cells_of(sources, grid), np.zeros_like(marked)
    run(_walk_all, threads, new_ticket(len(starts), 1), starts, _cells_of(targets.boxes, grid), met)
    for axis in range(3):  # the one-ring, axis by axis
        met = np.moveaxis(met, axis, 0)
        ring = met.copy()
        ring[1:] |= met[:-1]
        ring[:-1] |= met[1:]
        met = np.moveaxis(ring, 0, axis)
    marked |= met


# ---------------------------------------------------------------------------------------------------------------------
# Marks a convex region around receivers and light: what the paper's grid improves on [Selgrad et al. 2015, Fig. 2b].
#
# The region is bounded by pairs of parallel planes in 13 directions: the axes, and the diagonals of faces and of the
# cube. It encloses all sources and targets, and so the segments between them.


_DIRECTIONS = np.array([d for d in product((-1, 0, 1), repeat=3) if d > (0, 0, 0)], float)


def _spans(boxes: np.ndarray) -> np.ndarray:
    """(2, 13) float64: the least and the largest coordinate of (m, 2, 3) boxes along each direction."""
    along = boxes[:, :, None] * _DIRECTIONS
    return np.stack([along.min(1).sum(-1).min(0), along.max(1).sum(-1).max(0)])


def _cells(grid) -> np.ndarray:
    """(3, n, 2) float64: the first and the last coordinate of each cell along each axis, rounded outwards."""
    low, high = grid.bounds.astype(np.float64)[:, :3, None]
    scale = grid.scale.astype(np.float64)[:3, None]
    size = np.divide(1.0, scale, out=np.zeros_like(scale), where=scale > 0.0)
    walls = np.minimum(low + size * np.arange(grid.n + 1), high)
    walls[:, -1:] = high
    pad = PAD * np.abs(grid.bounds).max()
    return np.stack([walls[:, :-1] - pad, np.where(size > 0.0, walls[:, 1:], high) + pad], -1)


def mark_convex(sources: np.ndarray, targets, grid, marked: np.ndarray, threads: int) -> None:
    """Mark cells like `swept.mark_hulls`: all cells that the region meets."""
    near, ends = _spans(sources), _spans(targets.boxes)
    far = near + ends if targets.relative else ends
    low, high = np.minimum(near[0], far[0]), np.maximum(near[1], far[1])
    cells, pad = _cells(grid), 3.0 * PAD * max(np.abs(low).max(), np.abs(high).max())
    inside = np.ones(marked.shape, np.bool_)
    for direction, least, most in zip(_DIRECTIONS, low - pad, high + pad):
        along = [cells[axis] * direction[axis] for axis in range(3)]
        first, last = (
            x[:, None, None] + y[:, None] + z
            for x, y, z in (map(extreme, along, (1, 1, 1)) for extreme in (np.min, np.max))
        )
        inside &= (first <= most) & (last >= least)
    marked |= inside
