"""Tiles of heights in one grid, as a single surface without cracks. Where they overlap, the first height counts."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...base.errors import InputError
from ...formats.reprojection import WARP
from ...scene.terrain import GridPoints, HeightGrid, Heights

_BETWEEN = 1e-4  # cells: tiles whose cells differ by less coincide


class TiledHeights:
    """Heights of tiles, read when they are needed.

    Raises
    ------
    InputError
        If two tiles have different CRS, or do not share a grid.
    """

    def __init__(self, tiles: Sequence[Heights]):
        first = tiles[0]
        for tile in tiles[1:]:
            _check_grid(tile, first)
        self._tiles, places = tiles, [_place_in(tile.grid, first.grid) for tile in tiles]
        top, left = min(row for row, _ in places), min(column for _, column in places)
        self._places = [(row - top, column - left) for row, column in places]
        rows = max(row + tile.grid.rows for tile, (row, _) in zip(tiles, self._places))
        columns = max(column + tile.grid.columns for tile, (_, column) in zip(tiles, self._places))
        grid = first.grid
        self.name = f"{first.name} and {len(tiles) - 1} more" if tiles[1:] else first.name
        self.crs, self.dtype = first.crs, np.result_type(*(tile.dtype for tile in tiles))
        self.grid = GridPoints(grid.west + left * grid.dx, grid.north - top * grid.dy, grid.dx, grid.dy, rows, columns)

    def rows(self, first: int, last: int) -> NDArray[Any]:
        """Heights of some rows, (last - first, columns) `dtype`; NaN: no data."""
        heights = np.full((last - first, self.grid.columns), np.nan, self.dtype)
        for tile, (row, column) in zip(self._tiles, self._places):
            low, high = max(first, row), min(last, row + tile.grid.rows)
            if low < high:
                part = heights[low - first : high - first, column : column + tile.grid.columns]
                np.copyto(part, tile.rows(low - row, high - row), where=np.isnan(part))
        return heights


def joined_heights(tiles: Sequence[HeightGrid]) -> HeightGrid:
    """Tiles in memory as a single raster."""
    joined = TiledHeights(tiles)
    return HeightGrid(joined.name, joined.grid, joined.crs, joined.rows(0, joined.grid.rows))


def _check_grid(tile: Heights, first: Heights) -> None:
    """Raise an InputError unless the cells of a tile continue those of the first one."""
    grid = first.grid
    if tile.crs != first.crs:
        raise InputError(f"{tile.name}: its CRS is {tile.crs}, and that of {first.name} {first.crs}; warp one")
    spacing = abs(tile.grid.dx - grid.dx) * tile.grid.columns + abs(tile.grid.dy - grid.dy) * tile.grid.rows
    steps = np.array([(tile.grid.west - grid.west) / grid.dx, (grid.north - tile.grid.north) / grid.dy])
    if spacing > _BETWEEN * grid.dx or np.abs(steps - np.round(steps)).max() > _BETWEEN:
        command = f"{WARP} -tr SIZE SIZE -tap FILE OUT.tif"
        raise InputError(f"{tile.name}: its cells do not continue those of {first.name}; warp one with: {command}")


def _place_in(tile: GridPoints, grid: GridPoints) -> tuple[int, int]:
    """Row and column of a tile's first cell in the grid of another one."""
    return round((grid.north - tile.north) / grid.dy), round((tile.west - grid.west) / grid.dx)
