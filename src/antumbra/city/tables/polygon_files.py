"""Polygons as results: the outlines of cells of a raster, and files of GeoPackage, GeoJSON and GeoParquet."""

import io
import json
import os
import warnings
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...base.extras import import_extra
from ...base.files import atomic_output, checked_output
from ...scene.crs import checked_crs
from ...scene.raster import Raster
from .result_table import undated

VECTORS = {".gpkg": "GPKG", ".geojson": "GeoJSON", ".parquet": "Parquet"}
"""Suffix -> format of files of polygons."""

_WORLD = "EPSG:4326"  # of GeoJSON [RFC 7946]


def check_polygon_output(path: str | os.PathLike[str]) -> Path:
    """The path; an InputError, before long work, unless `write_polygons` can write to it."""
    target = checked_output(path, tuple(VECTORS))
    suffix = target.suffix.lower()
    for package in ("geopandas", "pyarrow" if suffix == ".parquet" else "pyogrio"):
        import_extra(package, suffix, "gis")
    return target


def write_polygons(path: Path, frame: Any, layer: str) -> None:
    """Write a GeoDataFrame in the format of the suffix. GeoJSON is in WGS 84 if the CRS is known."""
    suffix = path.suffix.lower()
    if suffix == ".geojson" and frame.crs is not None:
        frame = frame.to_crs(_WORLD)
    data = io.BytesIO()  # GDAL warns of the suffixes of temporary files
    if suffix == ".parquet":
        frame.to_parquet(data, compression="zstd")
    else:
        pyogrio = import_extra("pyogrio", suffix, "gis")
        with undated(), warnings.catch_warnings(action="ignore", category=UserWarning):  # of a missing CRS
            pyogrio.write_dataframe(frame, data, driver=VECTORS[suffix], layer=layer)
    with atomic_output(path) as temporary:
        temporary.write_bytes(data.getvalue())


def level_crs(crs: str) -> Any:
    """The horizontal part of a CRS, since polygons have no heights."""
    full = import_extra("pyproj", "crs", "gis").CRS.from_user_input(checked_crs(crs))
    return full.sub_crs_list[0] if full.is_compound else full


def outlines(classes: NDArray[np.int16], raster: Raster) -> list[tuple[int, Any]]:
    """(class, shapely MultiPolygon) for each class from 0 on: the outlines of cells, joined along their edges.

    classes : (rows, columns) int16; negative: no polygon
    """
    shapely = import_extra("shapely", "shadow", "gis")
    features = import_extra("rasterio.features", "shadow", "gis")
    transform = import_extra("rasterio", "shadow", "gis").transform.from_origin(
        raster.west, raster.north, raster.spacing, raster.spacing
    )
    parts: dict[int, list[Any]] = {}
    for shape, value in features.shapes(classes, mask=classes >= 0, transform=transform):
        parts.setdefault(int(value), []).append(shapely.from_geojson(json.dumps(shape)))
    return [(value, shapely.MultiPolygon(parts[value])) for value in sorted(parts)]
