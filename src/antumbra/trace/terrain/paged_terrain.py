"""`PagedTerrain`: heights that are read by page, for rays from a window of the cells up to the far horizon.

Only the pages are read that rays from the window can reach below their greatest height. The frame, the bits and the
faces are those of the whole surface, at `PAGED_BYTES` a cell.
"""

from collections.abc import Iterator
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...base.progress import report_progress
from ...scene.height_surveys import PAGE, HeightSurvey, read_vertices
from ...scene.raster import CellWindow
from ...scene.terrain import BLOCK, GridPoints, Heights, number_vertices, triangles_of
from .bordered_terrain import INSIDE, BorderedTerrain, bordered_shape, bordered_terrain

PAGED_BYTES = 4.6
"""Memory of a cell that is read."""

_SURE = 2.0**-20  # relative tolerance of places and heights along rays: more than all rounding to float32
_AROUND = 4  # cells


def _wider(window: CellWindow, by: int, grid: GridPoints) -> CellWindow:
    """A window with more cells on each side, within a grid."""
    row, column = max(window.row - by, 0), max(window.column - by, 0)
    last_row = min(window.row + window.rows + by, grid.rows)
    last_column = min(window.column + window.columns + by, grid.columns)
    return CellWindow(row, column, last_row - row, last_column - column)


def _times(
    pages: NDArray[np.int64], side: tuple[int, int], far: float, step: float
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """When rays, from their begin at 0 to their end at 1, are first and last over pages along an axis.

    pages : the first vertex of each
    side : the first cell of the window, and the one after its last
    far : cells by which pages are widened
    step : cells from the begin to the end of a ray
    """
    low, high = pages - far - side[1], pages + PAGE + far - side[0]
    if step == 0.0:
        there = (low <= 0.0) & (high >= 0.0)
        return np.where(there, 0.0, np.inf), np.where(there, 1.0, -np.inf)
    ends = np.sort([low / step, high / step], axis=0)
    return np.maximum(ends[0], 0.0), np.minimum(ends[1], 1.0)


class PagedTerrain:
    """The surface of heights that are read where they are needed.

    surface : Heights
    survey : HeightSurvey
        Of the surface.
    where : str
        Its name in progress.
    """

    def __init__(self, surface: Heights, survey: HeightSurvey, where: str):
        self.surface, self.survey, self._where = surface, survey, where
        self.whole = CellWindow(0, 0, surface.grid.rows, surface.grid.columns)
        counts = survey.triangles
        self._before = np.cumsum(counts).reshape(counts.shape) - counts  # triangles before each block
        self._faces_of_band, self._reached = lru_cache(2)(self._find_faces), lru_cache(64)(self._find_reached)
        self._near: tuple[CellWindow, BorderedTerrain] | None = None  # the latest

    def __reduce__(self) -> tuple[type["PagedTerrain"], tuple[Heights, HeightSurvey, str]]:
        return PagedTerrain, (self.surface, self.survey, self._where)

    # --- Rays ---------------------------------------------------------------------------------------------------------

    def reached(self, offsets: NDArray[np.float64], height: float, window: CellWindow) -> CellWindow:
        """The window around all pages that rays reach below their greatest height, and around `window`.

        offsets : (n, 3) from the begin to the end of each ray
        height : the lowest one at which some of the rays begin, in the frame
        window : the cells over which they begin
        """
        return self._reached(offsets.tobytes(), height, window)

    def _find_reached(self, directions: bytes, height: float, window: CellWindow) -> CellWindow:
        """`reached`; `directions`: the bytes of offsets."""
        grid, survey, offsets = self.surface.grid, self.survey, np.frombuffer(directions).reshape(-1, 3)
        far = _AROUND + _SURE * (grid.rows + grid.columns)  # cells
        around = _wider(window, int(far) + 1, grid)
        if around == self.whole:
            return around
        tops = survey.tops - survey.origin[2]
        steps = offsets / [grid.dx, -grid.dy, 1.0]
        pages = [np.arange(n) * PAGE for n in tops.shape]
        sides = (window.row, window.row + window.rows), (window.column, window.column + window.columns)
        size = float(np.abs(survey.bounds - survey.origin).max())
        reached = np.zeros(tops.shape, bool)
        for (along, down, rise), offset in zip(steps, offsets):
            first, last = _times(pages[0], sides[0], far, down)
            begin, end = _times(pages[1], sides[1], far, along)
            begins, ends = np.maximum(first[:, None], begin), np.minimum(last[:, None], end)
            inside = begins <= ends
            begins, ends = np.where(inside, begins, 0.0), np.where(inside, ends, 0.0)
            lowest = height + (begins if rise > 0.0 else ends) * rise
            sure = _SURE * (size + abs(height) + ends * np.abs(offset).max())
            reached |= inside & (lowest - sure <= tops)
        at = np.flatnonzero(reached.any(1)), np.flatnonzero(reached.any(0))
        if not len(at[0]):
            return around
        (row, last_row), (column, last_column) = ((PAGE * int(each[0]), PAGE * (int(each[-1]) + 1)) for each in at)
        return around.joined(_wider(CellWindow(row, column, last_row - row, last_column - column), 1, grid))

    @property
    def held(self) -> float:
        """Bytes of the part that was read."""
        return 0.0 if self._near is None else PAGED_BYTES * self._near[0].n_cells

    def read(self, part: CellWindow, room: float) -> BorderedTerrain | None:
        """The terrain of a part, or of a larger one, with the bits of the whole.

        room : bytes that it may take, with those that are `held`; it is None if it takes more
        """
        near = self._near
        if near is not None and near[0].includes(part):
            return near[1]
        if near is not None and PAGED_BYTES * part.joined(near[0]).n_cells <= room:
            part = part.joined(near[0])
        if PAGED_BYTES * part.n_cells > room:
            return None
        near = self._near = None  # freed before the next one is read
        rows, columns = part.slices
        padded = np.full(bordered_shape(part.rows, part.columns), np.nan, np.float32)
        with report_progress(f"{self._where}: heights of {part.n_cells:,} cells") as progress:
            read_vertices(self.surface, rows, columns, self.survey.origin, padded[INSIDE], progress)
        terrain = bordered_terrain(self.surface.grid, padded, self.survey.origin, part.row, part.column)
        self._near = part, terrain
        return terrain

    # --- Cells --------------------------------------------------------------------------------------------------------

    def cell_tops(self, window: CellWindow | None = None) -> tuple[NDArray[np.float64], NDArray[np.integer]]:
        """The height and the face at each cell of a window, as `TerrainSurfaces.tops`."""
        rows, columns = (window or self.whole).slices
        heights = self.surface.rows(rows.start, rows.stop)[:, columns].reshape(-1).astype(np.float64)
        faces, row = list[NDArray[np.int64]](), rows.start
        while row < rows.stop:
            band = min(row // BLOCK[0], len(self._before) - 1)
            part = self._faces_of_band(band, columns.start, columns.stop)[row - band * BLOCK[0] :][: rows.stop - row]
            faces.append(part.reshape(-1))
            row += len(part)
        found = np.concatenate([*faces, np.empty(0, np.int64)])
        heights[found < 0] = np.nan
        return heights, found

    def _find_faces(self, band: int, first: int, last: int) -> NDArray[np.int64]:
        """(rows, last - first) int64: the faces of columns of a band of blocks, as by `face_of_cells`."""
        grid, (high, wide), counts = self.surface.grid, BLOCK, self.survey.triangles
        row, end = band * high, min((band + 1) * high, grid.rows - 1) + 1
        blocks = range(max(first // wide - 1, 0), min(-(-last // wide), counts.shape[1]))  # they share vertices
        west = blocks.start * wide
        faces = np.full((end - row, min(blocks.stop * wide + 1, grid.columns) - west), -1, np.int64)
        heights = self.surface.rows(max(row - 1, 0), end)
        for part, into, number in self._blocks_of_band(band, blocks, heights, faces):
            found = np.full(part.shape, -1, np.int64)
            number_vertices(part, number, found)
            np.copyto(into, found[-len(into) :], where=found[-len(into) :] >= 0)
        is_last = band == len(counts) - 1
        return faces[: None if is_last else high, first - west : last - west]

    def _blocks_of_band(
        self, band: int, blocks: range, heights: NDArray[Any], faces: NDArray[np.int64]
    ) -> Iterator[tuple[NDArray[Any], NDArray[np.int64], int]]:
        """Yield (heights, faces of its last rows, first triangle) of each block, after the last squares of those above.

        heights : of the vertices of the band, and of the row before
        """
        grid, wide, before, counts = self.surface.grid, BLOCK[1], self._before, self.survey.triangles
        places = [slice(k * wide, min((k + 1) * wide, grid.columns - 1) + 1) for k in blocks]
        for k, at in zip(blocks, places) if band > 0 else ():
            edge = heights[:2, at]
            number = int(before[band - 1, k] + counts[band - 1, k]) - triangles_of(edge)
            yield edge, faces[:1, at.start - places[0].start :][:, : edge.shape[1]], number
        for k, at in zip(blocks, places):
            part = heights[1 if band > 0 else 0 :, at]
            yield part, faces[:, at.start - places[0].start :][:, : part.shape[1]], int(before[band, k])
