"""Horizontal rasters of square cells: aligned to multiples of the spacing, fitted to bounds, or of a raster file."""

from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from ..checks import as_array, instance, number, points, text, whole_number
from ..engine.scene import AnyScene
from ..errors import InputError
from ..extras import import_extra
from ..files import checked_file

SUFFIXES = (".tif", ".tiff", ".vrt", ".asc")
"""Suffixes of raster files whose cells `raster_of_file` takes."""

_MOST = 200_000_000  # sensors: more is taken for a mistake in the spacing
_SAME = 1e-6  # cells: edges nearer to each other than this are one, whatever rounding did


class Raster(NamedTuple):
    """A horizontal raster of square cells. Row 0 is the farthest north, as in pictures and GIS files."""

    west: float  # world coordinate of the left edge, along X
    north: float  # distance of the upper edge towards north: along Y if Z is up, else along -Z
    spacing: float  # side of a cell, world units
    columns: int  # cells from west to east
    rows: int  # cells from north to south
    crs: str | None = None  # of the file whose cells they are

    @property
    def area(self) -> float:
        """Of a cell, square world units."""
        return self.spacing * self.spacing

    @property
    def n_cells(self) -> int:
        """The number of cells."""
        return self.rows * self.columns

    def middles(self) -> tuple[np.ndarray, np.ndarray]:
        """(columns,) and (rows,) float64: distances of the cells' middles, to the east and to the north."""
        east = self.west + (np.arange(self.columns) + 0.5) * self.spacing
        return east, self.north - (np.arange(self.rows) + 0.5) * self.spacing

    def places(self, cells: np.ndarray, up: str) -> np.ndarray:
        """(n, 3) float64, world: the middles of cells (``row * columns + column``), at height 0."""
        east, north = self.middles()
        x, y = east[cells % self.columns], north[cells // self.columns]
        return np.stack([x, y, np.zeros(len(cells))] if up == "z" else [x, np.zeros(len(cells)), -y], 1)


def checked_raster(raster) -> Raster:
    """`raster`, if it is a `Raster` of sound numbers; otherwise an InputError."""
    instance(raster, Raster, "raster")
    for name in ("west", "north"):
        number(getattr(raster, name), f"{name} of the raster")
    number(raster.spacing, "the spacing of the raster", 0.0, np.inf)
    for name in ("columns", "rows"):
        whole_number(getattr(raster, name), f"{name} of the raster", 1, _MOST)
    if raster.crs is not None:
        text(raster.crs, "crs of the raster")
    check_count(raster.n_cells, raster.spacing)
    return raster


def plan_of(scene: AnyScene) -> np.ndarray:
    """(2, 2) float64: the scene's bounds to the east and to the north, lowest and highest."""
    (x0, y0, z0), (x1, y1, z1) = scene.bounds.tolist()
    return np.array([[x0, y0], [x1, y1]] if scene.up == "z" else [[x0, -z1], [x1, -z0]])


def aligned_raster(plan: np.ndarray, spacing: float) -> Raster:
    """The cells over bounds, as `plan_of` has them. Their edges are multiples of the spacing.

    So the cells are those of a raster file with such edges, whatever part of it the bounds are.
    """
    low, high = _checked(plan)
    with np.errstate(over="ignore", invalid="ignore"):
        first, last = np.floor(low / spacing + _SAME), np.ceil(high / spacing - _SAME)
        columns, rows = _counts(last - first, spacing)
    return Raster(float(first[0] * spacing), float((first[1] + rows) * spacing), spacing, columns, rows)


def raster_in(bounds: ArrayLike, spacing: float) -> Raster:
    """The cells that cover given bounds, from their north-west corner on.

    bounds : ((x0, n0), (x1, n1)), or (x0, n0, x1, n1)
    """
    plan = as_array(bounds, "bounds of the raster").astype(np.float64)
    if plan.shape not in ((2, 2), (4,)):
        raise InputError("bounds of the raster must be ((x0, n0), (x1, n1)): to the east and to the north")
    low, high = _checked(points(np.c_[plan.reshape(2, 2), np.zeros(2)], "bounds of the raster")[:, :2])
    with np.errstate(over="ignore"):
        columns, rows = _counts(np.ceil((high - low) / spacing - _SAME), spacing)
    return Raster(float(low[0]), float(high[1]), spacing, columns, rows)


def check_count(count: float, spacing: float) -> None:
    """Raise an InputError if a spacing needs more than 200 million sensors."""
    if not count <= _MOST:
        raise InputError(f"a spacing of {spacing:g} needs {count:.2g} sensors, more than {_MOST:.0e}; make it wider")


def _checked(plan: np.ndarray) -> np.ndarray:
    low, high = plan
    if not (low < high).all():
        raise InputError(f"the raster is from {low.tolist()} to {high.tolist()}; it must have a width and a height")
    return plan


def _counts(cells: np.ndarray, spacing: float) -> tuple[int, int]:
    """Columns and rows, at least 1 each."""
    cells = np.maximum(cells, 1.0)
    check_count(float(cells.prod()), spacing)
    return int(cells[0]), int(cells[1])


def raster_of_file(path: Path) -> Raster:
    """The cells of a raster file, such as a GeoTIFF of heights.

    Raises
    ------
    InputError
        If the file cannot be read, or has cells that are no squares with north up.
    """
    checked_file(path, path.name)
    rasterio = import_extra("rasterio", path.suffix, "gis")
    try:
        with rasterio.open(path) as file:
            shape, place, crs = file.shape, file.transform, file.crs
    except rasterio.errors.RasterioError as error:
        raise InputError(f"{path.name}: cannot be read ({' '.join(str(error).split())[:120]})") from None
    if not (place.b == place.d == 0.0 and place.a > 0.0 and abs(place.a + place.e) < _SAME * place.a):
        raise InputError(f"{path.name}: its cells are no squares with north up; warp it with: gdalwarp -tr SIZE SIZE")
    check_count(float(shape[0]) * shape[1], place.a)
    return Raster(place.c, place.f, place.a, shape[1], shape[0], crs.to_string() if crs else None)
