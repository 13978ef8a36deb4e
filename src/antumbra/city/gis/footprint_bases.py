"""The lowest terrain under footprints.

On a triangulated surface, the minimum over a polygon lies at a vertex of the surface inside the polygon, at a corner of
the polygon, or where an edge of the polygon crosses an edge of the surface. All of these are compared.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...scene.terrain import HeightGrid
from .footprint_table import PolygonRings

_AT_A_TIME = 1 << 22  # cells


class _PolygonEdges(NamedTuple):
    """The edges of polygons, in columns and rows of a grid."""

    begin: NDArray[np.float64]  # (e, 2)
    end: NDArray[np.float64]  # (e, 2)
    polygon: NDArray[np.int64]  # (e,)


class _EdgeCrossings(NamedTuple):
    """Points where edges cross the lines on which a linear function is a whole number."""

    edge: NDArray[np.int64]  # (k,)
    line: NDArray[np.int64]  # (k,) the whole number
    point: NDArray[np.float64]  # (k, 2) column and row


def lowest_under(surface: HeightGrid, rings: PolygonRings) -> NDArray[np.float64]:
    """(p,) float64: the lowest height of a surface under each polygon; NaN where it has no heights."""
    cells = surface.grid.cells_of(rings.corners)
    edges = _PolygonEdges(cells, cells[rings.following], rings.polygon_of_corner)
    lowest = np.full(len(rings.rings_in), np.nan)
    np.fmin.at(lowest, edges.polygon, surface.at_cells(*cells.T))
    for weights in (1.0, 0.0), (0.0, 1.0), (1.0, -1.0):  # columns, rows and diagonals of the grid
        crossings = _crossings(edges, np.array(weights))
        np.fmin.at(lowest, edges.polygon[crossings.edge], surface.at_cells(*crossings.point.T))
    _lower_inside(surface, edges, lowest)
    return lowest


def _crossings(edges: _PolygonEdges, weights: NDArray[np.float64], half_open: bool = False) -> _EdgeCrossings:
    """Crossings with the lines of ``column * weights[0] + row * weights[1]``; `half_open`: not at the upper end."""
    a, b = edges.begin @ weights, edges.end @ weights
    low, high = np.minimum(a, b), np.maximum(a, b)
    first, last = np.ceil(low), np.ceil(high) - 1.0 if half_open else np.floor(high)
    counts = np.where(a != b, np.maximum(last - first + 1.0, 0.0), 0.0).astype(np.int64)
    edge = np.repeat(np.arange(len(a)), counts)
    line = first[edge] + np.arange(len(edge)) - np.repeat(np.cumsum(counts) - counts, counts)
    share = (line - a[edge]) / (b - a)[edge]
    point = edges.begin[edge] + share[:, None] * (edges.end - edges.begin)[edge]
    return _EdgeCrossings(edge, line.astype(np.int64), point)


def _lower_inside(surface: HeightGrid, edges: _PolygonEdges, lowest: NDArray[np.float64]) -> None:
    """Lower the minima to the vertices of the surface inside the polygons, row by row of the grid."""
    crossings = _crossings(edges, np.array([0.0, 1.0]), half_open=True)
    polygon, column = edges.polygon[crossings.edge], crossings.point[:, 0]
    order = np.lexsort((column, crossings.line, polygon))
    polygon, row, column = polygon[order][::2], crossings.line[order][::2], column[order].reshape(-1, 2)
    first = np.maximum(np.ceil(column[:, 0]), 0.0).astype(np.int64)
    last = np.minimum(np.floor(column[:, 1]), surface.grid.columns - 1.0).astype(np.int64)
    there = (row >= 0) & (row < surface.grid.rows) & (first <= last)
    polygon, row, first, last = polygon[there], row[there], first[there], last[there]
    ends = np.cumsum(last - first + 1)
    start = 0
    while start < len(ends):
        stop = max(int(np.searchsorted(ends, (ends[start - 1] if start else 0) + _AT_A_TIME)), start + 1)
        counts = (last - first + 1)[start:stop]
        span = np.repeat(np.arange(start, stop), counts)
        cell = first[span] + np.arange(len(span)) - np.repeat(np.cumsum(counts) - counts, counts)
        np.fmin.at(lowest, polygon[span], surface.heights[row[span], cell].astype(np.float64))
        start = stop
