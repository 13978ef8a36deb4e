"""Heights from arrays with a transform, from the DataArrays of xarray and rioxarray, and from lists of tiles."""

from collections.abc import Sequence
from os import PathLike
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from ...base.checks import as_array, path_of, quoted
from ...base.errors import InputError
from ...base.memory import check_reading
from ...scene.raster import RasterAxes
from ...scene.terrain import GridPoints, HeightGrid
from .height_files import (
    HeightOptions,
    check_cells,
    check_projected,
    checked_heights,
    crs_of,
    grid_of,
    height_scale,
    heights_of,
    notes_of,
    part_of,
    range_of,
    read_heights,
)
from .height_tiles import joined_heights
from .raster_files import SUFFIXES

RasterLike: TypeAlias = "str | PathLike[str] | tuple[Any, ...] | Any"
"""A raster of heights: a path, a DataArray, or (array, transform) or (array, transform, crs)."""

FORMS = "a raster file, a DataArray, (array, transform) or (array, transform, crs), or a list of these"

_WORLD = "EPSG:4326"  # CRS of longitudes and latitudes that name none
_CELL_BYTES = 20.0  # of a cell of a DataArray while it is read
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
    if is_data_array(raster):
        return DataArrayHeights(raster, options).whole()
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
    check_cells(grid, where)
    check_projected(system, where, grid)
    grid, rows, columns = part_of(grid, options.clip, where)
    heights = np.ascontiguousarray((heights[::-1] if south_up else heights)[rows, columns])
    checked, more = checked_heights(HeightGrid("terrain", grid, text, heights), where)
    return checked, [*notes, *more]


def _checked_array(array: Any, options: HeightOptions, where: str, offset: float = 0.0) -> NDArray[Any]:
    """Heights, (rows, columns) float32 or float64, times `HeightOptions.z_scale` plus an offset."""
    if array.ndim != 2 or array.dtype.kind not in "fiu":
        raise InputError(f"{where}: heights must be numbers (rows, columns), not {array.dtype} {array.shape}")
    scale = 1.0 if options.z_scale is None else options.z_scale
    return heights_of(array, options.nodata, scale, offset, _type_of(array.dtype, scale, offset))


def _type_of(stored: np.dtype[Any], scale: float, offset: float) -> np.dtype[Any]:
    """float32 if that represents all heights of an array, else float64."""
    single = (scale, offset) == (1.0, 0.0) and (stored.itemsize <= 2 or stored == np.float32)
    return np.dtype(np.float32 if single else np.float64)


# --- DataArrays -------------------------------------------------------------------------------------------------------


def is_data_array(value: Any) -> bool:
    """Whether a value is a DataArray of xarray, or looks like one. It may be lazy, so no values are read."""
    return all(hasattr(value, name) for name in ("dims", "coords", "dtype", "attrs", "isel"))


class DataArrayHeights:
    """Heights of a DataArray, whose coordinates are those of its values. A lazy one is read when rows are needed.

    axes : the dimensions of the array, for results in its form
    """

    def __init__(self, raster: Any, options: HeightOptions):
        named = getattr(raster, "name", None)
        self._where, self.name = f"the DataArray {named}" if named else "the DataArray", str(named or "terrain")
        where, dims = self._where, raster.dims
        raster = _on_map(raster, where)
        rows, columns = raster.dims
        y, x = (_coordinates(raster, dimension, where) for dimension in raster.dims)
        whole = GridPoints(float(x.min()), float(y.max()), _step(x), _step(y), len(y), len(x))
        attributes = {**getattr(raster, "encoding", {}), **raster.attrs}
        system = _system_of(raster) if options.crs is None else crs_of(options.crs)
        if system is None and any(set(_words(raster, d)) & {*_DEGREES["x"], *_DEGREES["y"]} for d in raster.dims):
            system = crs_of(_WORLD)
        check_projected(system, where, whole)
        nodata = attributes.get("_FillValue", attributes.get("nodata")) if options.nodata is None else options.nodata
        if nodata is None and "rio" in dir(raster) and hasattr(raster, "rio"):
            nodata = raster.rio.nodata
        scale, self.crs, self._unit_notes = height_scale(str(attributes.get("units", "")), system, options, where)
        factor, offset = float(raster.attrs.get("scale_factor", 1.0)), float(raster.attrs.get("add_offset", 0.0))
        nodata = None if nodata is None else float(nodata)
        self._options, self._offset = options._replace(nodata=nodata, z_scale=factor * scale), offset * scale
        self.dtype = _type_of(raster.dtype, factor * scale, self._offset)
        self.grid, of_rows, of_columns = part_of(whole, options.clip, where)
        flipped = y[0] < y[-1], x[0] > x[-1]
        turned = raster.isel({d: slice(None, None, -1) for d, turn in zip(raster.dims, flipped) if turn})
        self._raster = turned.isel({rows: of_rows, columns: of_columns})
        northings, eastings = (self._raster.coords[dimension].values for dimension in (rows, columns))
        order = tuple(dimension for dimension in dims if dimension in (rows, columns))
        self.axes = RasterAxes((rows, columns), northings, eastings, flipped, order)
        self._chunk: tuple[int, NDArray[Any]] | None = None  # the last one that was read, and its first row
        self._lowest = np.inf  # height read so far

    @property
    def n_cells(self) -> int:
        """The number of heights."""
        return self.grid.rows * self.grid.columns

    def rows(self, first: int, last: int) -> NDArray[Any]:
        """Heights of some rows, (last - first, columns) `dtype`; NaN: no data. Chunks are read whole, and once."""
        if not getattr(self._raster, "chunks", None):
            return self._read(first, last)
        heights, at, ends = np.empty((last - first, self.grid.columns), self.dtype), first, self._ends
        while at < last:
            k = int(np.searchsorted(ends, at, "right"))
            start, stop = int(ends[k - 1]) if k else 0, int(ends[k])
            if self._chunk is None or self._chunk[0] != start:
                self._chunk = start, self._read(start, stop)
            stop = min(stop, last)
            heights[at - first : stop - first] = self._chunk[1][at - start : stop - start]
            at = stop
        return heights

    @property
    def _ends(self) -> NDArray[np.int64]:
        """(n,) int64: the row after each chunk."""
        return np.cumsum(self._raster.chunks[0])

    def _read(self, first: int, last: int) -> NDArray[Any]:
        what = f"{self._where}: {last - first} rows of {self.grid.columns} cells"
        check_reading(_CELL_BYTES * float(self.grid.columns) * (last - first), what)
        values = self._raster.isel({self.axes.names[0]: slice(first, last)}).values
        heights = _checked_array(np.asarray(values), self._options, self._where, self._offset)
        self._lowest = min(self._lowest, range_of(heights, self._where)[0])
        return np.ascontiguousarray(heights)

    def notes(self) -> list[str]:
        """Notes about the unit of the heights, and about the rows that have been read so far."""
        return [*self._unit_notes, *notes_of(self._lowest, self._where)]

    def whole(self) -> tuple[HeightGrid, list[str]]:
        """All heights, and notes about them."""
        grid = HeightGrid(self.name, self.grid, self.crs, self._read(0, self.grid.rows))
        return checked_heights(grid, self._where)[0], self.notes()


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
