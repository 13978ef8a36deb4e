"""`Raster`: the place of a horizontal raster of square cells; `CellWindow`: a part of it."""

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..base.errors import InputError


class CellWindow(NamedTuple):
    """Some rows and columns of a raster."""

    row: int  # the first one
    column: int
    rows: int
    columns: int

    @property
    def slices(self) -> tuple[slice, slice]:
        """Its rows and columns."""
        return slice(self.row, self.row + self.rows), slice(self.column, self.column + self.columns)

    @property
    def n_cells(self) -> int:
        """The number of cells."""
        return self.rows * self.columns

    def includes(self, other: "CellWindow") -> bool:
        """Whether another window lies within this one."""
        return self.joined(other) == self

    def joined(self, other: "CellWindow") -> "CellWindow":
        """The window around both."""
        row, column = min(self.row, other.row), min(self.column, other.column)
        last = max(self.row + self.rows, other.row + other.rows)
        return CellWindow(
            row, column, last - row, max(self.column + self.columns, other.column + other.columns) - column
        )


class Raster(NamedTuple):
    """A horizontal raster of square cells. Row 0 is the northernmost, as in pictures and GIS files."""

    west: float  # world coordinate of the left edge, along X
    north: float  # northing of the upper edge: along Y if Z is up, else along -Z
    spacing: float  # side of a cell, world units
    columns: int  # cells from west to east
    rows: int  # cells from north to south
    crs: str | None = None  # CRS of the raster file that defines the cells

    @property
    def area(self) -> float:
        """Area of a cell, square world units."""
        return self.spacing * self.spacing

    @property
    def n_cells(self) -> int:
        """The number of cells."""
        return self.rows * self.columns

    def middles(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """(columns,) and (rows,) float64: eastings and northings of the cells' centres.

        Rasters with edges at multiples of the spacing have the same centres where they overlap, to the last bit.
        """
        columns, rows = (np.arange(count, dtype=np.float64) + 0.5 for count in (self.columns, self.rows))
        return _steps(self.west, self.spacing, columns), _steps(self.north, self.spacing, -rows)

    def places(self, cells: NDArray[np.integer], up: str) -> NDArray[np.float64]:
        """(n, 3) float64, world: the centres of cells (``row * columns + column``), at height 0."""
        east, north = self.middles()
        x, y = east[cells % self.columns], north[cells // self.columns]
        return np.stack([x, y, np.zeros(len(cells))] if up == "z" else [x, np.zeros(len(cells)), -y], 1)


class RasterAxes(NamedTuple):
    """The dimensions and coordinates of the labelled array that a raster was read from."""

    names: tuple[str, str]  # of the dimensions of rows and columns
    northings: NDArray[Any]  # (rows,) from north to south
    eastings: NDArray[Any]  # (columns,) from west to east
    flipped: tuple[bool, bool]  # whether rows run from south to north, and columns from east to west, in the array
    order: tuple[str, ...]  # of the dimensions in the array


def window_of(raster: Raster, window: CellWindow) -> Raster:
    """The raster of some cells of another one."""
    west = float(_steps(raster.west, raster.spacing, np.array(float(window.column))))
    north = float(_steps(raster.north, raster.spacing, np.array(-float(window.row))))
    return raster._replace(west=west, north=north, columns=window.columns, rows=window.rows)


def _steps(edge: float, spacing: float, steps: NDArray[np.float64]) -> NDArray[np.float64]:
    """(n,) float64: coordinates at a number of steps from an edge, rounded once if the edge is a multiple of them."""
    first = np.round(edge / spacing)
    return (first + steps) * spacing if first * spacing == edge else edge + steps * spacing


def window_within(raster: Raster, bounds: Sequence[float]) -> CellWindow:
    """The cells of a raster with centres in bounds, (x0, n0, x1, n1). InputError if there are none."""
    (x0, n0, x1, n1), (east, north) = bounds, raster.middles()
    columns, rows = np.flatnonzero((east >= x0) & (east <= x1)), np.flatnonzero((north >= n0) & (north <= n1))
    if not (len(columns) and len(rows)):
        west, south = raster.west, raster.north - raster.rows * raster.spacing
        place = f"{west:.10g},{south:.10g},{west + raster.columns * raster.spacing:.10g},{raster.north:.10g}"
        raise InputError(f"no cell of the raster has its centre in these bounds; the raster lies in {place}")
    return CellWindow(int(rows[0]), int(columns[0]), len(rows), len(columns))
