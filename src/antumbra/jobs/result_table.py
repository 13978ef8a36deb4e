"""Result tables: one row per sensor, columns with units, and their CRS; with writers for all output formats.

CSV, JSON, NPZ, Parquet, GeoTIFF, PNG and GLB. A writer takes a `Table`, the path, and the column that pictures show.
"""

import json
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from ..checks import instance, points, quoted, spelling_hint
from ..engine.scene import AnyScene
from ..engine.scene_loading import scene_of
from ..errors import InputError
from ..extras import import_extra
from ..files import atomic_output, checked_output
from ..scene.camera import Camera
from ..scene.crs import checked_crs
from .false_colours import coloured_model, false_colours
from .sensors import Sensors, check_on_scene

# --- Writers of tables: CSV, JSON, NPZ, Parquet, GeoTIFF, pictures and models -----------------------------------------
#
# Each takes a `table.Table`, the path, and the name of the column that pictures show.


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


# ---------------------------------------------------------------------------------------------------------------------
# Results that know what they are: columns of numbers, one row for each sensor, with units and a place on the earth.


class Column(NamedTuple):
    """Numbers, one for each sensor."""

    values: np.ndarray  # (n,) float, int or datetime64
    unit: str  # such as "h" or "kWh/m2"; empty: a pure number
    about: str  # one line


@dataclass(eq=False)
class Table:
    """The results of a job, one row for each sensor.

    sensors : Sensors
        One for each row.
    columns : dict of str to Column
        The first one is what pictures show.
    about : dict
        Facts of the whole job, as JSON can hold them: "job", "timezone", settings, and "crs": that of the scene, or
        else of the file whose cells a raster has.
    scene : Scene or None
        What the sensors belong to; pictures need it.
    camera : Camera or None
        Of pictures that are no maps. None: one that shows the whole scene.
    marks : (k, 3) float or None
        Points that pictures show as dots, world.
    """

    sensors: Sensors
    columns: dict[str, Column]
    about: dict[str, Any] = field(default_factory=dict)
    scene: AnyScene | None = None
    camera: Camera | None = None
    marks: np.ndarray | None = None

    def __post_init__(self):
        instance(self.sensors, Sensors, "sensors")
        if not isinstance(self.columns, dict) or not all(isinstance(name, str) for name in self.columns):
            raise InputError(f"columns are {quoted(self.columns)}; they must be a dict of names to antumbra.Column")
        for name, column in self.columns.items():
            values = instance(column, Column, f"column {name!r}").values
            if not isinstance(values, np.ndarray) or values.shape != (len(self.sensors),):
                raise InputError(f"column {name!r} must be an array of {len(self.sensors)} values, one for each sensor")
        if not isinstance(self.about, dict):
            raise InputError(f"about is {quoted(self.about)}; it must be a dict")
        if self.scene is not None:
            self.scene = scene_of(self.scene)
            check_on_scene(self.sensors, self.scene)
        if self.camera is not None:
            instance(self.camera, Camera, "camera")
        self.marks = None if self.marks is None else points(self.marks, "marks")
        raster = self.sensors.raster
        crs = (self.scene and self.scene.crs) or (raster and raster.crs)
        if crs:
            self.about = {"crs": crs, **self.about}

    def __len__(self) -> int:
        return len(self.sensors)

    def __getitem__(self, name: str) -> np.ndarray:
        """The values of a column. InputError names the columns if there is none of this name."""
        if not isinstance(name, str) or name not in self.columns:
            names = ", ".join(self.columns)
            raise InputError(f"there is no column {quoted(name)}; {spelling_hint(name, self.columns)}there are {names}")
        return self.columns[name].values

    def __repr__(self) -> str:
        return f"Table({len(self)} rows: {', '.join(self.columns)})"

    def save(self, path, column: str | None = None) -> None:
        """Write the table, in the format that the suffix names.

        .csv, .json, .npz and .parquet hold all columns; .parquet is GeoParquet if the CRS is known. .png is a picture
        in false colours with a legend, .glb the model in these colours, .tif a GeoTIFF of a raster. .parquet and .tif
        need ``antumbra[gis]``.

        Parameters
        ----------
        path : str or path-like
        column : str, optional
            The column of a picture or model. None: the first one.

        Raises
        ------
        InputError
            If the suffix is unknown, the format cannot hold this table, or the path cannot be written.
        """
        writer_of(path, self.sensors.kind)(self, Path(path), self.shown(column))

    def shown(self, column: str | None) -> str:
        """The name of the column that a picture shows. InputError if it is unknown or has no numbers."""
        if not self.columns:
            raise InputError("the table has no columns; there is nothing to show")
        name = next(iter(self.columns)) if column is None else column
        if self[name].dtype.kind not in "fiub":
            raise InputError(f"column {name!r} holds times, and a picture shows numbers; name another column")
        return name

    def of_faces(self, name: str) -> np.ndarray:
        """(faces,) float64: the mean of a column on each face of the scene, by area; NaN for faces without a sensor.

        Raises
        ------
        InputError
            If the sensors do not lie on faces.
        """
        sensors, scene = self.sensors, self.scene
        if sensors.faces is None or scene is None or sensors.kind == "vertex":
            raise InputError("values of faces need sensors on faces; use the sensors face or grid:SPACING")
        on = sensors.faces >= 0
        faces, areas = sensors.faces[on], np.ones(on.sum()) if sensors.areas is None else sensors.areas[on]
        total = np.bincount(faces, areas, scene.n_triangles)
        with np.errstate(invalid="ignore"):
            return np.bincount(faces, areas * self[name][on], scene.n_triangles) / total

    def rows(self) -> dict[str, np.ndarray]:
        """Name -> (n,) values of the sensors' own columns (x, y, z, nx, ny, nz, area, face), then of the results."""
        sensors = self.sensors
        found = dict(zip("xyz", sensors.points.T))
        if sensors.normals is not None:
            found |= dict(zip(("nx", "ny", "nz"), sensors.normals.T))
        if sensors.areas is not None:
            found["area"] = sensors.areas
        if sensors.faces is not None:
            found["face"] = sensors.faces
        return found | {name: column.values for name, column in self.columns.items()}
