"""Heights from arrays with a transform, from the DataArrays of xarray and rioxarray, and from lists of tiles."""

from collections.abc import Sequence
from os import PathLike
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from ...base.checks import as_array, path_of, quoted
from ...base.errors import InputError
from ...scene.terrain import GridPoints, HeightGrid
from .height_files import (
    HeightOptions,
    check_projected,
    checked_heights,
    crs_of,
    grid_of,
    height_scale,
    heights_of,
    read_heights,
)
from .height_tiles import joined_heights
from .raster_files import SUFFIXES

RasterLike: TypeAlias = "str | PathLike[str] | tuple[Any, ...] | Any"
"""A raster of heights: a path, a DataArray, or (array, transform) or (array, transform, crs)."""

FORMS = "a raster file, a DataArray, (array, transform) or (array, transform, crs), or a list of these"

_WORLD = "EPSG:4326"  # CRS of longitudes and latitudes that name none
_UNEVEN = 1e-3  # cells: coordinates of a DataArray, which may be float32, differ by less from even ones
_DEGREES = {
    "x": ("lon", "long", "lng", "longitude", "degree_east", "degrees_east"),
    "y": ("lat", "latitude", "degree_north", "degrees_north"),
}
_AXES = {
    "x": ("x", "e", "east", "easting", "eastings", *_DEGREES["x"], "projection_x_coordinate"),
    "y": ("y", "n", "north", "northing", "northings", *_DEGREES["y"], "projection_y_coordinate"),
}
"""Axis -> the names of its dimensions, and its standard names and units in the CF conventions, in lower case."""


def height_grid(raster: "RasterLike | Sequence[RasterLike]", options: HeightOptions) -> tuple[HeightGrid, list[str]]:
    """The heights of a raster or of several tiles, and notes about them.

    Raises
    ------
    InputError
        If a raster cannot be read, or tiles do not share a grid.
    """
    if isinstance(raster, list):
        if not raster:
            raise InputError("raster is an empty list; give at least one tile")
        tiles, notes = zip(*(_one(each, options) for each in raster))
        return joined_heights(list(tiles)), [note for each in notes for note in each]
    return _one(raster, options)


def _one(raster: RasterLike, options: HeightOptions) -> tuple[HeightGrid, list[str]]:
    if isinstance(raster, (str, PathLike)):
        return read_heights(path_of(raster, "raster"), options)
    if isinstance(raster, tuple) and len(raster) in (2, 3):
        return _of_array(raster[0], raster[1], raster[2] if raster[2:] else None, options)
    if all(hasattr(raster, name) for name in ("dims", "coords", "values", "attrs")):
        return _of_data_array(raster, options)
    raise InputError(f"raster is {quoted(raster)}; give {FORMS}")


# --- Arrays -----------------------------------------------------------------------------------------------------------


def _of_array(values: Any, transform: Any, crs: Any, options: HeightOptions) -> tuple[HeightGrid, list[str]]:
    where = "the raster"
    if hasattr(transform, "to_gdal"):
        transform = tuple(transform)[:6]
    place = as_array(transform, "transform of the raster").astype(np.float64)
    if place.shape not in ((6,), (9,), (3, 3), (2, 3)):
        raise InputError(f"transform of the raster has shape {place.shape}; give (a, b, c, d, e, f), as rasterio does")
    array = values if isinstance(values, np.ma.MaskedArray) else as_array(values, "heights of the raster")
    system = crs_of(crs if options.crs is None else options.crs)
    scale, text, notes = height_scale(None, system, options, where)
    heights = _checked_array(array, options._replace(z_scale=scale), where)
    grid, south_up = grid_of(place.reshape(-1)[:6], len(heights), heights.shape[1], options.values_at, where)
    check_projected(system, where, grid)
    heights = np.ascontiguousarray(heights[::-1] if south_up else heights)
    checked, more = checked_heights(HeightGrid("terrain", grid, text, heights), where)
    return checked, [*notes, *more]


def _checked_array(array: Any, options: HeightOptions, where: str, offset: float = 0.0) -> NDArray[Any]:
    """Heights, (rows, columns) float32 or float64, times `HeightOptions.z_scale` plus an offset."""
    if array.ndim != 2 or array.dtype.kind not in "fiu":
        raise InputError(f"{where}: heights must be numbers (rows, columns), not {array.dtype} {array.shape}")
    scale = 1.0 if options.z_scale is None else options.z_scale
    single = (scale, offset) == (1.0, 0.0) and (array.dtype.itemsize <= 2 or array.dtype == np.float32)
    return heights_of(array, options.nodata, scale, offset, np.dtype(np.float32 if single else np.float64))


# --- DataArrays -------------------------------------------------------------------------------------------------------


def _of_data_array(raster: Any, options: HeightOptions) -> tuple[HeightGrid, list[str]]:
    """Heights of a DataArray, whose coordinates are those of its values."""
    where = f"the DataArray {raster.name}" if getattr(raster, "name", None) else "the DataArray"
    raster = _on_map(raster, where)
    y, x = (_coordinates(raster, dimension, where) for dimension in raster.dims)
    grid = GridPoints(float(x.min()), float(y.max()), _step(x), _step(y), len(y), len(x))
    attributes = {**getattr(raster, "encoding", {}), **raster.attrs}
    system = _system_of(raster) if options.crs is None else crs_of(options.crs)
    if system is None and any(set(_words(raster, d)) & {*_DEGREES["x"], *_DEGREES["y"]} for d in raster.dims):
        system = crs_of(_WORLD)
    check_projected(system, where, grid)
    nodata = attributes.get("_FillValue", attributes.get("nodata")) if options.nodata is None else options.nodata
    if nodata is None and "rio" in dir(raster) and hasattr(raster, "rio"):
        nodata = raster.rio.nodata
    nodata = None if nodata is None else float(nodata)
    scale, text, notes = height_scale(str(attributes.get("units", "")), system, options, where)
    factor, offset = float(raster.attrs.get("scale_factor", 1.0)), float(raster.attrs.get("add_offset", 0.0))
    options = options._replace(nodata=nodata, z_scale=factor * scale)
    heights = _checked_array(np.asarray(raster.values), options, where, offset * scale)
    heights = heights[:: 1 if y[0] > y[-1] else -1, :: 1 if x[0] < x[-1] else -1]
    name = str(raster.name) if getattr(raster, "name", None) else "terrain"
    checked, more = checked_heights(HeightGrid(name, grid, text, np.ascontiguousarray(heights)), where)
    return checked, [*notes, *more]


def _on_map(raster: Any, where: str) -> Any:
    """A DataArray with the dimensions of its northings and eastings, in this order."""
    axes = {dimension: _axis_of(raster, dimension) for dimension in raster.dims}
    single = [d for d in raster.dims if axes[d] is None and raster.sizes[d] == 1]  # such as band or time
    raster = raster.isel(dict.fromkeys(single, 0)) if len(raster.dims) > 2 else raster
    found = ", ".join(map(str, raster.dims))
    if len(raster.dims) != 2:
        raise InputError(f"{where}: has the dimensions {found}; select two, y and x")
    first, second = (axes[dimension] for dimension in raster.dims)
    if first == second:
        names = ", ".join(f"{x}/{y}" for x, y in (("x", "y"), ("easting", "northing"), ("longitude", "latitude")))
        raise InputError(f"{where}: which of the dimensions {found} is x? rename them to {names}, or set their CF axis")
    return raster.transpose() if first == "x" or second == "y" else raster


def _axis_of(raster: Any, dimension: Any) -> str | None:
    """Whether a dimension is "x" or "y", by the CF axis, standard name or units of its coordinates, or its own name."""
    words = _words(raster, dimension)
    return next((axis for word in words for axis, names in _AXES.items() if word in names), None)


def _words(raster: Any, dimension: Any) -> list[str]:
    """What names the axis of a dimension, in lower case; the most binding first."""
    attributes = raster.coords[dimension].attrs if dimension in raster.coords else {}
    words = attributes.get("axis"), attributes.get("standard_name"), dimension, attributes.get("units")
    return [str(word).lower() for word in words]


def _coordinates(raster: Any, dimension: Any, where: str) -> NDArray[np.float64]:
    """(n,) float64: the evenly spaced coordinates of a dimension."""
    if dimension not in raster.coords:
        raise InputError(f"{where}: has no coordinates {dimension!r}; give (array, transform, crs)")
    values = np.asarray(raster.coords[dimension].values)
    if values.dtype.kind not in "fiu" or len(values) < 2:
        raise InputError(f"{where}: coordinates {dimension!r} must be at least two numbers")
    values = values.astype(np.float64)
    even = np.linspace(values[0], values[-1], len(values))
    if not np.isfinite(values).all() or not np.abs(values - even).max() <= _UNEVEN * _step(values):
        raise InputError(f"{where}: coordinates {dimension!r} are not evenly spaced; interpolate it on a regular grid")
    return values


def _step(values: NDArray[np.float64]) -> float:
    return float(abs(values[-1] - values[0]) / (len(values) - 1))


def _system_of(raster: Any) -> Any:
    """The CRS of a DataArray: that of its grid mapping, as rioxarray and the CF conventions store it."""
    name = raster.attrs.get("grid_mapping") or getattr(raster, "encoding", {}).get("grid_mapping") or "spatial_ref"
    if name not in raster.coords:
        return crs_of(raster.attrs.get("crs"))
    attributes = raster.coords[name].attrs
    return crs_of(attributes.get("crs_wkt") or attributes.get("spatial_ref"))


def is_raster(value: Any) -> bool:
    """Whether a value is a raster rather than a number, an array of numbers, or a column."""
    if isinstance(value, str):
        return value.lower().endswith(SUFFIXES)
    return isinstance(value, (PathLike, tuple)) or hasattr(value, "coords") or _is_tiles(value)


def _is_tiles(value: Any) -> bool:
    return isinstance(value, list) and bool(value) and all(map(is_raster, value))
