"""Rasters of results as labelled arrays: Datasets of xarray, and Zarr stores that are written by chunk.

Dimensions, coordinates and the grid mapping follow the CF conventions, by which xarray, rioxarray and GDAL read them.
"""

import json
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...base.extras import import_extra
from ...base.files import atomic_folder, check_disk_space
from ...scene.crs import checked_crs
from ...scene.raster import Raster, RasterAxes

_CHUNK = 256, 1024  # rows, as of the strips that are written, and columns: 1 MB
_MAPPING = "spatial_ref"  # the name that rioxarray expects
_AXES = (
    {"axis": "Y", "standard_name": "projection_y_coordinate"},
    {"axis": "X", "standard_name": "projection_x_coordinate"},
)


def dataset_of(
    raster: Raster, axes: RasterAxes | None, bands: Mapping[str, NDArray[np.float32]], units: Mapping[str, str],
    about: dict[str, Any],
) -> Any:  # fmt: skip
    """A Dataset of xarray.

    axes : of the array that the raster was read from, whose form the Dataset takes; None: y and x, north up
    bands : name -> (rows, columns) values, NaN: none
    units : name -> unit; empty: dimensionless
    about : metadata of the study
    """
    xarray = import_extra("xarray", "to_xarray", "xarray")
    axes = axes or _axes_of(raster)
    coordinates: dict[str, Any] = {
        name: (name, values, more) for name, values, more in zip(axes.names, (axes.northings, axes.eastings), _AXES)
    }
    coordinates[_MAPPING] = ((), np.int64(0), _mapping(raster, about.get("crs")))
    variables = {name: (axes.names, values, _attributes(units[name])) for name, values in bands.items()}
    found = xarray.Dataset(variables, coordinates, {"antumbra": json.dumps(about)})
    for name in bands:
        found[name].encoding["grid_mapping"] = _MAPPING
    turned = [name for name, flipped in zip(axes.names, axes.flipped) if flipped]
    return found.isel({name: slice(None, None, -1) for name in turned}).transpose(*axes.order)


@contextmanager
def zarr_of_bands(
    path: Path, raster: Raster, units: dict[str, str], about: dict[str, Any]
) -> Iterator[Callable[[int, NDArray[np.float32]], None]]:
    """Write a Zarr store of version 2, which all readers know, with an array for each band.

    The context is a function as that of `tiff_of_bands`, and so are the arguments.
    """
    zarr = import_extra("zarr", ".zarr", "xarray")
    axes, shape = _axes_of(raster), (raster.rows, raster.columns)
    check_disk_space(path, 4 * len(units) * raster.n_cells)
    with atomic_folder(path) as temporary:
        group = zarr.create_group(temporary, zarr_format=2, attributes={"antumbra": json.dumps(about)})

        def add(name: str, size: tuple[int, ...], dimensions: tuple[str, ...], kind: str, more: dict[str, Any]) -> Any:
            chunks = tuple(min(pair) for pair in zip(_CHUNK, size)) if len(size) == 2 else size
            about_array = {"_ARRAY_DIMENSIONS": list(dimensions), **more}
            fill = np.nan if kind == "float32" else None
            return group.create_array(
                name, shape=size, chunks=chunks, dtype=kind, fill_value=fill, attributes=about_array
            )

        for name, values, more in zip(axes.names, (axes.northings, axes.eastings), _AXES):
            add(name, (len(values),), (name,), "float64", more)[:] = values
        add(_MAPPING, (), (), "int64", _mapping(raster, about.get("crs")))[...] = 0
        mapped = {"grid_mapping": _MAPPING, "coordinates": _MAPPING}  # by the latter, xarray knows that it is no band
        arrays = [add(name, shape, axes.names, "float32", _attributes(unit) | mapped) for name, unit in units.items()]

        def write(first: int, values: NDArray[np.float32]) -> None:
            for array, band in zip(arrays, values):
                array[first : first + len(band)] = band

        yield write
        zarr.consolidate_metadata(temporary)


def _axes_of(raster: Raster) -> RasterAxes:
    east, north = raster.middles()
    return RasterAxes(("y", "x"), north, east, (False, False), ("y", "x"))


def _attributes(unit: str) -> dict[str, Any]:
    return {"units": unit or "1"}


def _mapping(raster: Raster, crs: str | None) -> dict[str, Any]:
    """The attributes of the grid mapping: the CRS in the terms of CF, and as GDAL writes it; and the transform."""
    size = raster.spacing
    place = " ".join(repr(float(each)) for each in (raster.west, size, 0.0, raster.north, 0.0, -size))
    if not crs:
        return {"GeoTransform": place}
    pyproj = import_extra("pyproj", "a CRS", "gis")
    terms = pyproj.CRS.from_user_input(checked_crs(crs)).to_cf()
    return {**terms, "spatial_ref": terms["crs_wkt"], "GeoTransform": place}
