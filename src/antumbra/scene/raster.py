"""`Raster`: the place of a horizontal raster of square cells."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray


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


def _steps(edge: float, spacing: float, steps: NDArray[np.float64]) -> NDArray[np.float64]:
    """(n,) float64: coordinates at a number of steps from an edge, rounded once if the edge is a multiple of them."""
    first = np.round(edge / spacing)
    return (first + steps) * spacing if first * spacing == edge else edge + steps * spacing
