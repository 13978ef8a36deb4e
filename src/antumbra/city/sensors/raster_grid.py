"""Horizontal rasters of square cells: aligned to multiples of the spacing, fitted to bounds, or from a raster file."""

from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ...base.checks import as_array, checked_instance, number, points, text, whole_number
from ...base.errors import InputError
from ...base.memory import check_reading
from ...engine.scene import AnyScene
from ...formats.reprojection import WARP
from ...scene.raster import Raster
from ...scene.scene_bounds import plan_bounds
from ..gis.raster_files import RasterFile

_MOST = 10_000_000_000  # sensors: more than this is treated as a mistake in the spacing
_BYTES = 100  # memory of a sensor while it is made, about
_SAME = 1e-6  # cells: edges closer than this coincide, up to rounding


def checked_raster(raster: Raster) -> Raster:
    """`raster`, if it is a `Raster` whose fields are valid; otherwise an InputError."""
    checked_instance(raster, Raster, "raster")
    for name in ("west", "north"):
        number(getattr(raster, name), f"{name} of the raster")
    number(raster.spacing, "the spacing of the raster", 0.0, np.inf)
    for name in ("columns", "rows"):
        whole_number(getattr(raster, name), f"{name} of the raster", 1, _MOST)
    if raster.crs is not None:
        text(raster.crs, "crs of the raster")
    check_count(raster.n_cells, raster.spacing)
    return raster


def plan_of(scene: AnyScene) -> NDArray[np.float64]:
    """(2, 2) float64: the scene's lower and upper bounds, in easting and northing."""
    return plan_bounds(scene.bounds, scene.up)


def aligned_raster(plan: np.ndarray, spacing: float) -> Raster:
    """The cells that cover bounds, as from `plan_of`; their edges are multiples of the spacing.

    The cells therefore match those of a raster file with such edges, for any part of it that the bounds cover.
    """
    low, high = _checked(plan)
    with np.errstate(over="ignore", invalid="ignore"):
        first, last = np.floor(low / spacing + _SAME), np.ceil(high / spacing - _SAME)
        columns, rows = _counts(last - first, spacing)
    return Raster(float(first[0] * spacing), float((first[1] + rows) * spacing), spacing, columns, rows)


def raster_in(bounds: ArrayLike, spacing: float) -> Raster:
    """The cells that cover bounds, starting at their north-west corner.

    bounds : ((x0, n0), (x1, n1)), or (x0, n0, x1, n1)
    """
    plan = as_array(bounds, "bounds of the raster").astype(np.float64)
    if plan.shape not in ((2, 2), (4,)):
        raise InputError("bounds of the raster must be ((x0, n0), (x1, n1)), each an easting and a northing")
    low, high = _checked(points(np.c_[plan.reshape(2, 2), np.zeros(2)], "bounds of the raster")[:, :2])
    with np.errstate(over="ignore"):
        columns, rows = _counts(np.ceil((high - low) / spacing - _SAME), spacing)
    return Raster(float(low[0]), float(high[1]), spacing, columns, rows)


def check_count(count: float, spacing: float) -> None:
    """Raise an InputError if a spacing needs more than ten thousand million sensors."""
    if not count <= _MOST:
        raise InputError(f"a spacing of {spacing:g} needs {count:.2g} sensors, more than {_MOST:.0e}; make it wider")


def check_memory(count: float) -> None:
    """Raise an InputError if some sensors cannot be in memory at once."""
    check_reading(_BYTES * count, f"making {count:,.0f} sensors at once")


def _checked(plan: np.ndarray) -> np.ndarray:
    low, high = plan
    if not (low < high).all():
        raise InputError(f"the raster is from {low.tolist()} to {high.tolist()}; it must have a width and a height")
    return plan


def _counts(cells: np.ndarray, spacing: float) -> tuple[int, int]:
    """Numbers of columns and rows, each at least 1."""
    cells = np.maximum(cells, 1.0)
    check_count(float(cells.prod()), spacing)
    return int(cells[0]), int(cells[1])


def raster_of_file(path: Path) -> Raster:
    """The cells of a raster file, such as a GeoTIFF of heights.

    Raises
    ------
    InputError
        If the file cannot be read, or its cells are not square with north up.
    """
    with RasterFile(path).open() as file:
        shape, place, crs = file.shape, file.transform, file.crs
    if not (place.b == place.d == 0.0 and place.a > 0.0 and abs(place.a + place.e) < _SAME * place.a):
        command = f"{WARP} -tr SIZE SIZE FILE OUT.tif"
        raise InputError(f"{path.name}: its cells are not square with north up; warp it with: {command}")
    check_count(float(shape[0]) * shape[1], place.a)
    return Raster(place.c, place.f, place.a, shape[1], shape[0], crs.to_string() if crs else None)
