"""Marks a convex region around receivers and light: what the paper's grid improves on [Selgrad et al. 2015, Fig. 2b].

The region is bounded by pairs of parallel planes in 13 directions: the axes, and the diagonals of faces and of the
cube. It encloses all sources and targets, and so the segments between them.
"""

from itertools import product

import numpy as np

from ...techniques.culling.culling_grid import PAD

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
