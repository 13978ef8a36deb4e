"""Rasters of heights for views without their triangles: 4 bytes a cell, in memory or in a scratch file.

The frame and the float32 vertices are those of the scene of the same raster, so lines of sight have the same bits.
"""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from tempfile import TemporaryFile
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...base.errors import InputError
from ...base.files import check_disk_space
from ...base.progress import ProgressCallback
from ...scene.scene_bounds import NEAREST, check_extent, flush_to_zero, frame_origin
from ...scene.scene_data import MemoryData
from ...scene.terrain import HeightGrid, TerrainSurfaces
from ...trace.terrain.terrain_views import Ground, KnownHeights, ground_of
from .height_files import HeightFile, extremes

_BAND = 256  # rows at a time
_CACHED = 8  # rows converted at a time
_AROUND = 4  # cells on each side of a place, in its window
_TRIES = 64
_FAR = 2.0**-50  # the next float64 to one of this size is more than NEAREST away


class HeightGround(NamedTuple):
    """The heights of a file in the frame of its scene."""

    file: HeightFile
    ground: Ground  # NaN: no vertex of a triangle
    bounds: NDArray[np.float64]  # (2, 3)
    origin: NDArray[np.float64]  # (3,)

    def heights(self, first: int, last: int) -> NDArray[np.float64]:
        """(rows, columns) float64, world: the heights of vertices in some rows; NaN: none."""
        heights = self.file.rows(first, last).astype(np.float64)
        heights[np.isnan(self.ground.z[first:last])] = np.nan
        return heights

    def window(self, plan: NDArray[np.float64]) -> MemoryData:
        """The scene of the cells around a place, (2,) easting and northing, in the frame of the whole raster."""
        grid = self.file.grid
        column, row = (
            int(np.clip(at, 0, n - 1))
            for at, n in zip(np.floor(grid.cells_of(plan[None])[0]), (grid.columns, grid.rows))
        )
        west, rows = _start(grid.eastings(), column), _start(grid.northings(), row)
        size = min(row + _AROUND, grid.rows) - rows, min(column + _AROUND, grid.columns) - west
        east, north = float(grid.eastings()[west]), float(grid.northings()[rows])
        part = grid._replace(west=east, north=north, rows=size[0], columns=size[1])
        heights = self.heights(rows, rows + size[0])[:, west : west + size[1]]
        surface = HeightGrid(self.file.name, part, self.file.crs, np.ascontiguousarray(heights))
        try:
            data = MemoryData(
                TerrainSurfaces([surface], self.file.name),
                name=self.file.name,
                up="z",
                crs=surface.crs,
                unit=self.file.unit,
            )
        except InputError:
            at = ",".join(f"{each:.10g}" for each in plan)
            raise InputError(f"{self.file.path.name}: has no surface around {at}; move the observer") from None
        data.bounds, data.origin, data.middle = self.bounds, self.origin, self.origin
        data.raster = grid.raster(surface.crs)
        return data


def plane_of(file: HeightFile) -> MemoryData:
    """A horizontal surface in the place of a file, with its CRS."""
    grid = file.grid
    size = {"dx": (grid.columns - 1) * grid.dx, "dy": (grid.rows - 1) * grid.dy}
    corners = grid._replace(rows=2, columns=2, **size)
    surface = HeightGrid(file.name, corners, file.crs, np.zeros((2, 2)))
    return MemoryData(TerrainSurfaces([surface], file.name), name=file.name, up="z", crs=file.crs, unit=file.unit)


def _start(places: NDArray[np.float64], at: int) -> int:
    """The first cell of a window around a cell, from which steps give the same coordinates to the last bit."""
    step = abs(places[-1] - places[0]) / (len(places) - 1) * np.sign(places[-1] - places[0])
    steps = np.arange(2 * _AROUND + _TRIES) * step
    for first in range(max(at - _AROUND, 0), max(at - _AROUND - _TRIES, -1), -1):
        if (places[first] + steps[: len(places) - first] == places[first : first + len(steps)]).all():
            return first
    return 0


@contextmanager
def height_ground(file: HeightFile, beside: Path | None, progress: ProgressCallback) -> Iterator[HeightGround]:
    """The `HeightGround` of a file.

    beside : a path in whose folder the heights are kept in a scratch file; None: in memory

    Raises
    ------
    InputError
        If the file cannot be read, or the folder has no room.
    """
    grid = file.grid
    shape = grid.rows, grid.columns
    if beside is None:
        yield _filled(file, np.empty(shape, np.float32), progress)
        return
    check_disk_space(beside, 4 * grid.rows * grid.columns)
    with TemporaryFile(dir=beside.parent) as scratch:
        yield _filled(file, np.memmap(scratch, np.float32, "w+", shape=shape).view(np.ndarray), progress)


def _filled(file: HeightFile, z: NDArray[np.float32], progress: ProgressCallback) -> HeightGround:
    """The ground of a file, whose heights are written to z."""
    grid, single = file.grid, file.dtype == np.float32
    bands = [slice(first, min(first + _BAND, grid.rows)) for first in range(0, grid.rows, _BAND)]
    whole, ends = np.zeros(grid.rows, bool), list[tuple[float, float]]()
    for k, band in enumerate(bands):
        heights = z[band] = file.rows(band.start, band.stop)
        ends.append((float(heights.min()), float(heights.max())))
        whole[band] = not np.isnan(ends[-1][0])
        progress(k, 2 * len(bands))
    counted, low, high = _remove_bare(z, bands, whole), np.inf, -np.inf
    for (lowest, highest), band in zip(ends, bands):
        if not whole[band].all():
            heights = z[band] if single else np.where(np.isnan(z[band]), np.nan, file.rows(band.start, band.stop))
            lowest, highest = extremes(heights)
        low, high = min(low, lowest), max(high, highest)  # NaN changes neither
    if not counted.rows.any():
        raise InputError(f"{file.path.name}: no cell has a height; check nodata and the band")
    plan = [grid.eastings()[counted.columns], grid.northings()[counted.rows]]
    bounds = np.array([[plan[0].min(), plan[1].min(), low], [plan[0].max(), plan[1].max(), high]])
    check_extent(bounds, file.path.name)
    origin = frame_origin(*bounds)
    for k, band in enumerate(bands):
        heights = z[band] if single else np.where(np.isnan(z[band]), np.nan, file.rows(band.start, band.stop))
        for row in range(0, len(heights), _CACHED):
            local = z[band][row : row + _CACHED]
            np.subtract(heights[row : row + _CACHED], origin[2], out=local, dtype=np.float64, casting="same_kind")
            if abs(origin[2]) < _FAR:  # from other origins, a height is 0 or far more away
                local[np.abs(local) < NEAREST] = 0.0  # as `flush_to_zero`, in place
        progress(len(bands) + k, 2 * len(bands))
    x, y = (
        flush_to_zero((each - o).astype(np.float32)) for each, o in zip((grid.eastings(), grid.northings()), origin)
    )
    reach = np.abs(flush_to_zero((bounds[:, 2] - origin[2]).astype(np.float32))).max()
    known = KnownHeights(whole, float(reach))
    return HeightGround(file, ground_of(x, y, z, known), bounds, origin)


class _Counted(NamedTuple):
    """Which rows and columns have vertices."""

    rows: NDArray[np.bool_]
    columns: NDArray[np.bool_]


def _remove_bare(z: NDArray[np.float32], bands: list[slice], whole: NDArray[np.bool_]) -> _Counted:
    """Set heights to NaN that belong to no triangle.

    whole : (rows,) those in bands without a missing height, and finally without a missing vertex
    """
    counted = _Counted(np.ones(z.shape[0], bool), np.zeros(z.shape[1], bool))
    before = np.isfinite(z[:0])  # the last row of the band before, as it was
    for band in bands:
        after = ~np.isnan(z[band.stop : band.stop + 1])
        if before.all() and after.all() and whole[band].all():
            before, counted.columns[:] = ~np.isnan(z[band.stop - 1 : band.stop]), True
            continue
        here = ~np.isnan(z[band])
        there = np.concatenate([before, here, after])
        before = here[-1:]
        diagonal = there[:-1, :-1] & there[1:, 1:]
        south, east = diagonal & there[1:, :-1], diagonal & there[:-1, 1:]
        used = np.zeros(there.shape, bool)
        used[:-1, :-1] |= south | east
        used[1:, 1:] |= south | east
        used[1:, :-1] |= south
        used[:-1, 1:] |= east
        first = len(there) - len(after) - len(here)
        used = used[first : first + len(here)]
        z[band][~used] = np.nan
        whole[band] = used.all()
        counted.rows[band], counted.columns[:] = used.any(1), counted.columns | used.any(0)
    return counted
