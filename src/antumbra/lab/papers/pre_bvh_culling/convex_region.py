"""Marks the cells in a convex region around receivers and lights, the baseline that the grid of lines improves on.

The region is bounded by pairs of parallel planes in 13 directions: the axes, and the diagonals of the cube and its
faces. It encloses all sources and targets, and therefore the segments between them [Selgrad et al. 2015, Fig. 2b].
"""

from itertools import product
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ....query.shadow_query import ShadowQuery
from ....techniques.culling.culling_grid import PAD, CellGrid, cell_size, sources_of, targets_of
from ....techniques.culling.pre_bvh_culling import MarkingMethod, segment_box
from .light_cells import cell_bounds

_DIRECTIONS = np.array([d for d in product((-1, 0, 1), repeat=3) if d > (0, 0, 0)], float)


def _spans(boxes: NDArray[np.float64]) -> NDArray[np.float64]:
    """(2, 13) float64: minimum and maximum of (m, 2, 3) boxes along each direction."""
    along = boxes[:, :, None] * _DIRECTIONS
    return np.stack([along.min(1).sum(-1).min(0), along.max(1).sum(-1).max(0)])


def mark_convex(
    sources: NDArray[Any], query: ShadowQuery, grid: CellGrid, marked: NDArray[np.uint8], threads: int
) -> int:
    """Mark cells like `mark_hulls`: all cells that the region overlaps."""
    targets = targets_of(query, cell_size(grid))
    source_spans, target_spans = _spans(sources), _spans(targets.boxes)
    end_spans = source_spans + target_spans if targets.relative else target_spans
    low, high = np.minimum(source_spans[0], end_spans[0]), np.maximum(source_spans[1], end_spans[1])
    cells, pad = cell_bounds(grid), 3.0 * PAD * max(np.abs(low).max(), np.abs(high).max())
    inside = np.ones(marked.shape, np.bool_)
    for direction, least, most in zip(_DIRECTIONS, low - pad, high + pad):
        along = [cells[axis] * direction[axis] for axis in range(3)]
        first, last = (
            x[:, None, None] + y[:, None] + z
            for x, y, z in (map(extreme, along, (1, 1, 1)) for extreme in (np.min, np.max))
        )
        inside &= (first <= most) & (last >= least)
    marked |= inside
    return len(targets.boxes)


CONVEX = MarkingMethod(segment_box, sources_of, mark_convex)
"""A convex region, in a grid over the segments."""
