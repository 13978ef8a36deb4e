"""What one pass over heights finds: their bounds, the greatest heights of their pages, their triangles.

Memory is that of a few bands of rows. Afterwards, any part of the raster can be read as vertices in the frame of the
whole.
"""

from collections.abc import Iterator
from hashlib import sha256
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..base.errors import InputError
from ..base.progress import ProgressCallback
from .scene_bounds import check_extent, flush_to_zero, frame_origin
from .terrain import BLOCK, Heights

PAGE = 256
"""Vertices along the sides of a page. Its squares reach to the vertices that follow in the next pages."""

_CACHED = 8  # rows converted at a time


class HeightSurvey(NamedTuple):
    """The bounds and the frame of the scene of a raster, and what its parts hold."""

    bounds: NDArray[np.float64]  # (2, 3)
    origin: NDArray[np.float64]  # (3,)
    tops: NDArray[np.float64]  # (rows, columns) of pages: the greatest heights, world; -inf: none
    lows: NDArray[np.float64]  # likewise, the lowest heights; inf: none
    triangles: NDArray[np.int64]  # (rows, columns) of the blocks of a terrain
    digest: bytes  # SHA-256 of all heights


class _Band(NamedTuple):
    """Heights of some rows, (n, columns), with the row before and the row after, if there are any."""

    first: int
    above: NDArray[Any]
    heights: NDArray[Any]
    below: NDArray[Any]
    is_whole: bool  # whether none of these is missing

    @property
    def used(self) -> NDArray[np.bool_]:
        """(n, columns) bool: whether the heights belong to triangles."""
        there = ~np.isnan(np.concatenate([self.above, self.heights, self.below]))
        used = np.zeros(there.shape, bool)
        diagonal = there[:-1, :-1] & there[1:, 1:]
        south, east = diagonal & there[1:, :-1], diagonal & there[:-1, 1:]
        used[:-1, :-1] |= south | east
        used[1:, 1:] |= south | east
        used[1:, :-1] |= south
        used[:-1, 1:] |= east
        return used[len(self.above) : len(self.above) + len(self.heights)]


def _bands(surface: Heights, rows: slice, columns: slice) -> Iterator[_Band]:
    """The bands of a part of a surface; each row is read about once."""
    above = surface.rows(max(rows.start - 1, 0), rows.start)[:, columns]
    for first in range(rows.start - rows.start % PAGE, rows.stop, PAGE):
        start, stop = max(first, rows.start), min(first + PAGE, rows.stop)
        heights = surface.rows(start, stop)[:, columns]
        below = surface.rows(stop, min(stop + 1, surface.grid.rows))[:, columns]
        is_whole = not any(each.size and np.isnan(each.min()) for each in (above, heights, below))
        yield _Band(start, above, heights, below, is_whole)
        above = heights[-1:].copy()


def survey_heights(surface: Heights, where: str, progress: ProgressCallback, is_digested: bool = True) -> HeightSurvey:
    """Read heights once.

    where : name in errors
    is_digested : whether the survey has a digest

    Raises
    ------
    InputError
        If they cannot be read, or no cell has a height.
    """
    grid = surface.grid
    of_rows, of_columns = np.zeros(grid.rows, bool), np.zeros(grid.columns, bool)
    low, high, digest = np.inf, -np.inf, sha256()
    tops, lows, triangles = list[NDArray[np.float64]](), list[NDArray[np.float64]](), list[NDArray[np.int64]]()
    for band in _bands(surface, slice(0, grid.rows), slice(0, grid.columns)):
        progress(band.first, grid.rows)
        if is_digested:
            digest.update(np.ascontiguousarray(band.heights).data)
        rows, heights = slice(band.first, band.first + len(band.heights)), band.heights
        if band.is_whole:
            of_rows[rows], of_columns[:] = True, True
        else:
            used = band.used
            of_rows[rows], of_columns, heights = used.any(1), of_columns | used.any(0), heights[used]
        low, high = min(low, float(heights.min(initial=np.inf))), max(high, float(heights.max(initial=-np.inf)))
        tops.append(_of_pages(band, np.fmax, -np.inf))
        lows.append(_of_pages(band, np.fmin, np.inf))
        if len(band.heights) + len(band.below) > 1:
            triangles.append(_squares(band))
    if not of_rows.any():
        raise InputError(f"{where}: no cell has a height; check nodata and the band")
    plan = [grid.eastings()[of_columns], grid.northings()[of_rows]]
    bounds = np.array([[plan[0].min(), plan[1].min(), low], [plan[0].max(), plan[1].max(), high]])
    check_extent(bounds, where)
    pages = np.stack(tops), np.stack(lows)
    return HeightSurvey(bounds, frame_origin(*bounds), *pages, np.stack(triangles), digest.digest())


def _of_pages(band: _Band, extreme: np.ufunc, nothing: float) -> NDArray[np.float64]:
    """(pages,) float64: the extreme heights of a row of pages, which include the first row and column of the next."""
    parts = [extreme.reduce(each, 0) for each in (band.heights, band.below) if len(each)]
    columns = extreme.reduce(parts, 0).astype(np.float64)
    starts = np.arange(0, len(columns), PAGE)
    pages = extreme.reduceat(columns, starts)
    pages[:-1] = extreme(pages[:-1], columns[starts[1:]])
    return np.where(np.isnan(pages), nothing, pages)


def _squares(band: _Band) -> NDArray[np.int64]:
    """(blocks,) int64: the triangles of a row of blocks."""
    rows, columns = len(band.heights) + len(band.below) - 1, band.heights.shape[1] - 1
    starts = np.arange(0, columns, BLOCK[1])
    if band.is_whole:
        return 2 * rows * np.diff(np.append(starts, columns))
    there = ~np.isnan(np.concatenate([band.heights, band.below]))
    diagonal = there[:-1, :-1] & there[1:, 1:]
    count = (diagonal & there[1:, :-1]).sum(0) + (diagonal & there[:-1, 1:]).sum(0)
    return np.add.reduceat(count, starts).astype(np.int64)


def read_vertices(
    surface: Heights, rows: slice, columns: slice, origin: NDArray[np.float64], z: NDArray[np.float32],
    progress: ProgressCallback,
) -> None:  # fmt: skip
    """Write the heights of some rows and columns to z, float32 in the frame at `origin`; NaN: no vertex of a triangle.

    Vertices along the border may be those of triangles outside.
    """
    wider = slice(max(columns.start - 1, 0), min(columns.stop + 1, surface.grid.columns))
    inside = slice(columns.start - wider.start, columns.stop - wider.start)
    for band in _bands(surface, rows, wider):
        progress(band.first - rows.start, rows.stop - rows.start)
        used = None if band.is_whole else band.used
        for row in range(0, len(band.heights), _CACHED):
            some = slice(row, row + _CACHED)
            local = band.heights[some, inside].astype(np.float64) - origin[2]
            if used is not None:
                local[~used[some, inside]] = np.nan
            into = band.first - rows.start + row
            z[into : into + len(local)] = flush_to_zero(local.astype(np.float32))
