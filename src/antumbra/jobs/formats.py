"""Writers of tables: CSV, JSON, NPZ, Parquet, GeoTIFF, pictures and models.

Each takes a `table.Table`, the path, and the name of the column that pictures show.
"""

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from ..errors import InputError
from ..extras import import_extra
from ..files import atomic_output, checked_output
from ..scene.crs import checked_crs
from .model import coloured_model
from .picture import false_colours

_ROWS = 1 << 16  # rows that are made into text at a time
_POINT_Z = 1001  # of well-known binary: a point with three coordinates


def _csv(table, path: Path, column: str) -> None:
    columns = table.rows()
    with atomic_output(path) as temporary, open(temporary, "w", encoding="utf-8", newline="") as file:
        file.write(",".join(columns) + "\n")
        for first in range(0, len(table), _ROWS):
            texts = [_texts(values[first : first + _ROWS]) for values in columns.values()]
            file.writelines(",".join(row) + "\n" for row in zip(*texts))


def _texts(values: np.ndarray) -> list[str]:
    """Numbers as text: the shortest that gives the same number; nothing for NaN and for no time. Quoted names."""
    if values.dtype.kind == "U":
        return ['"' + text.replace('"', '""') + '"' if set(text) & set(',"\r\n') else text for text in values.tolist()]
    if values.dtype.kind == "M":
        return ["" if text == "NaT" else text for text in np.datetime_as_string(values).tolist()]
    return ["" if value != value else str(value) for value in values.tolist()]


def _json(table, path: Path, column: str) -> None:
    rows = {name: _plain(values) for name, values in table.rows().items()}
    told = {"about": table.about, "columns": _units(table), "rows": rows}
    with atomic_output(path) as temporary:
        temporary.write_text(json.dumps(told, allow_nan=False), encoding="utf-8")


def _plain(values: np.ndarray) -> list:
    """Values that JSON can hold: None for NaN."""
    if values.dtype.kind == "M":
        return [text or None for text in _texts(values)]
    return [None if value != value else value for value in values.tolist()]


def _units(table) -> dict[str, dict[str, str]]:
    return {name: {"unit": column.unit, "about": column.about} for name, column in table.columns.items()}


def _npz(table, path: Path, column: str) -> None:
    told = json.dumps({"about": table.about, "columns": _units(table)})
    with atomic_output(path) as temporary, open(temporary, "wb") as file:
        np.savez_compressed(file, allow_pickle=False, about=np.array(told), **table.rows())


def _parquet(table, path: Path, column: str) -> None:
    import_extra("pyarrow", ".parquet", "gis")
    import pyarrow
    import pyarrow.parquet

    moments = lambda values: values.astype("datetime64[ms]") if values.dtype.kind == "M" else values  # no minutes there
    columns = {name: pyarrow.array(moments(values)) for name, values in table.rows().items()}
    told = {"antumbra": json.dumps({"about": table.about, "columns": _units(table)})}
    if table.about.get("crs"):
        columns["geometry"] = pyarrow.array(_well_known(_on_map(table)), pyarrow.binary())
        told["geo"] = json.dumps(_geo(table))
    made = pyarrow.table(columns).replace_schema_metadata(told)
    with atomic_output(path) as temporary:
        pyarrow.parquet.write_table(made, temporary, compression="zstd")


def _on_map(table) -> np.ndarray:
    """(n, 3) float64: easting, northing and height of the sensors."""
    points = table.sensors.points
    return points[:, [0, 2, 1]] * [1.0, -1.0, 1.0] if table.scene is not None and table.scene.up == "y" else points


def _well_known(points: np.ndarray) -> list[bytes]:
    """Points as well-known binary."""
    rows = np.empty(len(points), [("order", "u1"), ("kind", "<u4"), ("xyz", "<f8", 3)])
    rows["order"], rows["kind"], rows["xyz"] = 1, _POINT_Z, points
    data, size = rows.tobytes(), rows.itemsize
    return [data[k : k + size] for k in range(0, len(data), size)]


def _geo(table) -> dict:
    """The metadata of GeoParquet 1.1."""
    from pyproj import CRS

    at = _on_map(table)
    low, high = at.min(0), at.max(0)
    column: dict = {"encoding": "WKB", "geometry_types": ["Point Z"], "bbox": [*low.tolist(), *high.tolist()]}
    column["crs"] = CRS.from_user_input(checked_crs(table.about["crs"])).to_json_dict()
    return {"version": "1.1.0", "primary_column": "geometry", "columns": {"geometry": column}}


def _tiff(table, path: Path, column: str) -> None:
    raster = table.sensors.raster
    assert raster is not None
    import_extra("rasterio", ".tif", "gis")
    import rasterio

    names = [name for name, made in table.columns.items() if made.values.dtype.kind in "fiub"]
    shape = {"width": raster.columns, "height": raster.rows, "count": len(names)}
    place = rasterio.transform.from_origin(raster.west, raster.north, raster.spacing, raster.spacing)
    options = {"driver": "GTiff", "dtype": "float32", "nodata": np.nan, "compress": "deflate", "transform": place}
    if table.about.get("crs"):
        options["crs"] = checked_crs(table.about["crs"])  # as text: rasterio then keeps the code of a compound CRS
    with rasterio.MemoryFile() as memory:  # on a full disk, GDAL would print lines of its own
        with memory.open(**shape, **options) as file:
            _fill(file, table, names)
        with atomic_output(path) as temporary:
            temporary.write_bytes(memory.read())


def _fill(file, table, names: list[str]) -> None:
    """Write columns as the bands of an open GeoTIFF."""
    for band, name in enumerate(names, 1):
        file.write(table.sensors.on_raster(table[name]).astype(np.float32), band)
        file.set_band_description(band, name)
        file.set_band_unit(band, table.columns[name].unit)
    file.update_tags(antumbra=json.dumps(table.about))


def _png(table, path: Path, column: str) -> None:
    from PIL import Image

    made = Image.fromarray(false_colours(table, column))
    with atomic_output(path) as temporary:
        made.save(temporary, "PNG")


def _glb(table, path: Path, column: str) -> None:
    data = coloured_model(table, column)
    with atomic_output(path) as temporary:
        temporary.write_bytes(data)


WRITERS: dict[str, Callable[[Any, Path, str], None]] = {
    ".csv": _csv,
    ".json": _json,
    ".npz": _npz,
    ".parquet": _parquet,
    ".tif": _tiff,
    ".png": _png,
    ".glb": _glb,
}
"""Suffix -> writer(table, path, column)."""

_EXTRA = {".parquet": ("pyarrow", "gis"), ".tif": ("rasterio", "gis")}


def writer_of(path, kind: str) -> Callable[[Any, Path, str], None]:
    """The function that writes a table to this path: ask before long work begins.

    kind : the kind of the sensors

    Raises
    ------
    InputError
        If the suffix is unknown, the path cannot be written, a package is missing, or a GeoTIFF would hold no raster.
    """
    target = checked_output(path, tuple(WRITERS))
    suffix = target.suffix.lower()
    if suffix == ".tif" and kind != "raster":
        raise InputError(f"{target.name}: a GeoTIFF holds a raster, and the sensors are of kind {kind!r}; use .csv")
    if suffix in _EXTRA:
        package, extra = _EXTRA[suffix]
        import_extra(package, suffix, extra)
    return WRITERS[suffix]
