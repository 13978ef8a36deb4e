"""Sensors from command-line text and from point files: CSV, Parquet, NPZ, NPY and vector files."""

import csv
import json
import re
import warnings
from collections.abc import Collection, Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from ...base.checks import number, quoted, spelling_hint
from ...base.errors import InputError
from ...base.files import checked_file
from ...base.memory import check_reading
from ...engine.measured_scenes import measured_scene
from ...engine.scene import AnyScene
from ...engine.scene_loading import SceneLike
from ...formats.array_files import mapped_array, npz_arrays
from ...kernels.parallel import thread_count
from ...scene.crs import check_horizontal_crs, checked_crs
from ...scene.rounded_coordinates import rounding_notes
from ...scene.scene_bounds import bounds_of_points
from ..gis.csv_rows import check_fields, check_header
from ..gis.raster_files import SUFFIXES as RASTERS
from ..gis.vector_files import check_columns, open_parquet
from .ground_areas import AreaLike, area_sensors
from .point_attributes import Attributes, read_attributes
from .sensor_blocks import DescribedSensors, RasterBlocks, SurfaceBlocks
from .sensors import Sensors, checked_lift, point_sensors, raster_of, vertex_sensors
from .vector_points import SUFFIXES as VECTORS
from .vector_points import WORLD, PointFile, read_vector_points

FORMS = (
    "face[+LIFT], vertex[+LIFT], grid:SPACING[+LIFT], raster[:SPACING][+HEIGHT|@HEIGHT], raster:FILE.tif, "
    "or a .csv, .parquet, .npy, .npz, .gpkg, .geojson, .shp or .fgb file"
)
SUFFIXES = (".csv", ".parquet", ".npy", ".npz")
"""Suffixes of tables."""
POINT_SUFFIXES = (*SUFFIXES, *VECTORS)
"""Suffixes of files of points."""
_COPIES = 2  # of an array: as stored, and as float64

_ON_FACES = re.compile(r"(?:(face|vertex)|grid:([0-9.]+(?:[eE][+-]?[0-9]+)?|[0-9.eE-]+))(?:\+([0-9.eE+-]+))?")
_RASTER = re.compile(r"raster(?::([0-9.]+(?:[eE][0-9-]+)?|.+\.(?:tif|tiff|vrt|asc)))?(?:([+@])([0-9.eE+-]+))?", re.I)
CSV_ROWS = 1 << 16  # lines of a CSV file held as lists at a time
_POSITION, _NORMAL = ("x", "y", "z"), ("nx", "ny", "nz")
_DEGREES = ("longitude", "latitude", "z"), ("lon", "lat", "z")


def check_sensors(text: str, option: str = "sensors", areas: bool = False) -> None:
    """Raise an InputError, before a scene is read, unless `sensors_of` accepts the text; `areas`: for use in areas."""
    if not isinstance(text, str):
        raise InputError(f"{option} is {quoted(text)}; it must be {FORMS}")
    if areas and not _RASTER.fullmatch(text):
        forms = "raster[:SPACING][+HEIGHT|@HEIGHT] or raster:FILE.tif"
        raise InputError(f"{option} is {quoted(text)}; in areas it must be {forms}")
    if _ON_FACES.fullmatch(text):
        return
    if _RASTER.fullmatch(text):
        if file := raster_file(text):
            checked_file(Path(file), file)
        return
    check_point_file(text, option, FORMS, POINT_SUFFIXES)


def check_point_file(text: str, option: str, forms: str, suffixes: tuple[str, ...] = SUFFIXES) -> None:
    """Raise an InputError unless an option's text names a file; `forms`: the accepted forms, for the message."""
    path = Path(text)
    if path.suffix.lower() not in suffixes:
        hint = "" if "." in text else spelling_hint(text.partition(":")[0], ("face", "vertex", "grid", "raster"))
        raise InputError(f"{option} is {quoted(text)}; {hint}it must be {forms}")
    checked_file(path, path.name)


def raster_file(text: str) -> str | None:
    """The path in a text such as ``raster:FILE.tif``; None if it names no raster file."""
    raster = _RASTER.fullmatch(text)
    return raster[1] if raster and raster[1] and Path(raster[1]).suffix.lower() in RASTERS else None


def kind_of(text: str) -> str:
    """The kind of sensors that a checked text names."""
    word = re.split("[:+@]", text, maxsplit=1)[0].lower()
    return word if word in ("face", "vertex", "grid", "raster") else "points"


def sensors_of(text: str, scene: SceneLike, threads: int | None = None, areas: AreaLike | None = None) -> Sensors:
    """The sensors that a text names.

    With `areas`, in any form that `area_sensors` accepts, the text must start with ``raster``; heights are then above
    the ground of the areas.

    - ``face``, ``vertex``: one for each face, or for each distinct corner position
    - ``grid:1.5``: a grid on every surface
    - ``face+0.01``, ``vertex+0.01``, ``grid:1.5+0.01``: the same, lifted 0.01 off the surfaces along their normals
    - ``raster:2``, ``raster:2+1.6``, ``raster:2@30``: a horizontal raster on the highest surfaces, 1.6 above them,
      or at the coordinate 30; its cells begin at multiples of 2
    - ``raster``, ``raster+1.6``: the cells of the raster of heights that is the scene or its ground
    - ``raster:dem.tif``, ``raster:dem.tif+1.6``: the cells of a raster file
    - a point file: see `read_point_file`; points in another CRS than the scene's are reprojected
    """
    if areas is None:
        found = sensor_blocks(text, scene, threads)
        return found if isinstance(found, Sensors) else found.whole()
    check_sensors(text, areas=True)
    scene, threads = measured_scene(scene), thread_count(threads)
    cells, height, follow = _cells_of(text)
    return area_sensors(scene, areas, cells, height, follow=follow, threads=threads)


def sensor_blocks(text: str, scene: SceneLike, threads: int | None = None) -> Sensors | DescribedSensors:
    """The sensors of `sensors_of`, described if they can be made by block: those on faces and rasters."""
    check_sensors(text)
    scene, threads = measured_scene(scene), thread_count(threads)
    if on := _ON_FACES.fullmatch(text):
        lift = checked_lift(_number(on[3], text) if on[3] else 0.0)
        if on[1] == "vertex":
            return vertex_sensors(scene, lift=lift)
        spacing = number(_number(on[2], text), "the spacing of sensors", 0.0, np.inf) if on[2] else None
        return SurfaceBlocks(scene, spacing, lift)
    if _RASTER.fullmatch(text):
        cells, height, follow = _cells_of(text)
        return RasterBlocks(scene, raster_of(scene, cells), height, follow, cells is None, threads)
    return read_point_file(Path(text)).within(scene)


def _cells_of(text: str) -> tuple[str | float | None, float, bool]:
    """The file or the spacing of the cells that a text names, None: the scene's own; their height; `follow`."""
    raster = _RASTER.fullmatch(text)
    assert raster is not None  # checked before
    height = _number(raster[3], text) if raster[3] else 0.0
    return raster_file(text) or (_number(raster[1], text) if raster[1] else None), height, raster[2] != "@"


def check_file_crs(scene: AnyScene, *paths: Path | None) -> None:
    """Raise an InputError if a table names a CRS whose horizontal coordinates differ from the scene's."""
    for path in paths:
        if scene.crs and path is not None and path.suffix.lower() == ".parquet":
            with _reader_errors(path):
                crs = _crs_of(path)
                check_horizontal_crs(path.name, None if crs is None else checked_crs(crs), scene.crs)


def _number(text: str, sensors: str) -> float:
    try:
        value = float(text)
    except ValueError:
        value = np.nan
    if not np.isfinite(value):
        raise InputError(f"sensors are {sensors!r}; {text!r} is not a number")
    return value


def points_or_file(
    texts: list[str] | None, file: Path | None, one: str, many: str, flat: bool = False
) -> PointFile | None:
    """The points of a repeated option X,Y,Z or of a file; None without either. `flat`: as in `read_point_file`."""
    from ...cli.arguments import parse_point

    if texts and file is not None:
        raise InputError(f"{one} and {many} exclude each other; give one of them")
    if texts:
        return PointFile(point_sensors([parse_point(text, one) for text in texts]), one)
    if file is None:
        return None
    if file.suffix.lower() not in POINT_SUFFIXES:
        raise InputError(f"{many} is {str(file)!r}; it must be a {', '.join(POINT_SUFFIXES)} file")
    return read_point_file(file, flat)


def read_points(path: Path) -> Sensors:
    """The points of `read_point_file`, in the CRS of the file."""
    return read_point_file(path).sensors


def read_point_file(path: Path, flat: bool = False) -> PointFile:
    """Read points from a file.

    - CSV with a header, Parquet, NPZ: columns or arrays x, y, z, and optionally nx, ny, nz, and area; others become
      `Sensors.attributes`, which come through to the results. The columns longitude and latitude, or lon and lat, in
      degrees of WGS 84, may stand for x and y; GeoParquet without x and y has its points in its geometry
    - NPY: (n, 3) points, or (n, 6) points and normals
    - vector files: a layer of points

    flat : whether the heights of points may be missing, and are then 0

    Raises
    ------
    InputError
        If the file cannot be read, or a column is missing or holds anything but numbers.
    """
    suffix = path.suffix.lower()
    if suffix == ".npy":
        return PointFile(_from_array(read_array(path), path.name), path.name)
    if suffix in VECTORS:
        checked_file(path, path.name)
        return read_vector_points(path, flat)
    columns, position, crs = read_columns(path, (*_POSITION, *_NORMAL, "area")), _POSITION, None
    on_map = False
    if suffix == ".parquet":
        with _reader_errors(path):
            crs = _crs_of(path)
    if not {"x", "y"} & columns.keys():
        degrees = read_columns(path, (*_DEGREES[0], *_DEGREES[1]))
        form = next((form for form in _DEGREES if set(form[:2]) <= degrees.keys()), None)
        if form is not None:
            columns, position, crs, on_map = columns | {name: degrees[name] for name in form[:2]}, form, WORLD, True
        elif crs is not None:
            return read_vector_points(path, flat)
    if flat and "z" not in columns:
        columns["z"] = np.zeros(len(next(iter(columns.values()), ())))
    missing = [name for name in position if name not in columns]
    if missing:
        raise InputError(f"{path.name}: column {missing[0]!r} is missing; points need the columns x, y and z")
    normals = np.stack([columns[n] for n in _NORMAL], 1) if all(n in columns for n in _NORMAL) else None
    sensors = point_sensors(np.stack([columns[n] for n in position], 1), normals, columns.get("area"))
    _warn_of_rounding(sensors, path.name)
    sensors = replace(sensors, attributes=attributes_of(path, columns, len(sensors)))
    return PointFile(sensors, path.name, crs, on_map)


def attributes_of(path: Path, used: Collection[str], n: int) -> Attributes:
    """The columns of a file of n rows besides those with these lower-case names; see `read_attributes`."""
    with _reader_errors(path):
        return read_attributes(path, used, n)


def read_array(path: Path) -> np.ndarray:
    """The array in a .npy file. Raises InputError if it cannot be read."""
    with _reader_errors(path):
        array = mapped_array(path, path.name)
        check_reading(_COPIES * array.nbytes, path.name)
        return np.array(array)


def read_columns(path: Path, names: tuple[str, ...]) -> dict[str, np.ndarray]:
    """The columns of a .csv, .parquet or .npz file that have one of these lower-case names, as numbers.

    Raises
    ------
    InputError
        If the file cannot be read, or a column holds anything but numbers.
    """
    checked_file(path, path.name)
    reader = {".csv": _csv, ".parquet": _parquet, ".npz": _npz}[path.suffix.lower()]
    with _reader_errors(path):
        return reader(path, names)


@contextmanager
def _reader_errors(path: Path) -> Iterator[None]:
    """Turn errors of readers into an InputError that names the file."""
    try:
        yield
    except InputError:
        raise
    except Exception as error:  # csv, zipfile and pyarrow raise many kinds of errors for damaged files
        reason = " ".join(str(error).split())[:120] or type(error).__name__
        raise InputError(f"{path.name}: cannot be read ({reason}); write it again") from error


def _from_array(array: np.ndarray, name: str) -> Sensors:
    if array.ndim != 2 or array.shape[1] not in (3, 6) or array.dtype.kind not in "fiu":
        raise InputError(
            f"{name}: the array is {array.dtype} {array.shape}; points are (n, 3), points and normals (n, 6)"
        )
    sensors = point_sensors(array[:, :3], array[:, 3:] if array.shape[1] == 6 else None)
    _warn_of_rounding(sensors, name)
    return sensors


def _warn_of_rounding(sensors: Sensors, file: str) -> None:
    """A note if float32 has rounded the points of a file."""
    if len(sensors) > 1:
        points = sensors.points
        for note in rounding_notes(file, bounds_of_points(points), lambda: points, "write it in float64"):
            warnings.warn(note, UserWarning, stacklevel=3)


def _csv(path: Path, column_names: tuple[str, ...]) -> dict[str, np.ndarray]:
    with open(path, newline="", encoding="utf-8-sig") as file:
        rows = csv.reader(file)
        header = [name.strip().lower() for name in next(rows, [])]
        columns = [(k, name) for k, name in enumerate(header) if name in column_names]
        check_header([name for _, name in columns], path.name)
        tables, values = list[np.ndarray](), list[list[float]]()
        for line, row in enumerate(rows, 2):
            if not row:
                continue
            check_fields(len(row), len(header), line, path.name)
            try:
                values.append([float(row[k]) for k, _ in columns])
            except (ValueError, IndexError):
                line_text = ",".join(row)[:60]
                raise InputError(f"{path.name}, line {line}: {line_text!r} lacks a number of a point") from None
            if len(values) == CSV_ROWS:  # an array takes a fifth of the memory
                tables, values = [*tables, np.array(values, np.float64)], []
    table = np.concatenate([*tables, np.array(values, np.float64).reshape(len(values), len(columns))])
    return {name: table[:, k] for k, (_, name) in enumerate(columns)}


def _parquet(path: Path, column_names: tuple[str, ...]) -> dict[str, np.ndarray]:
    with open_parquet(path) as file:
        names = [name for name in file.schema_arrow.names if name.lower() in column_names]
        for name in names:
            _check_kind(np.dtype(file.schema_arrow.field(name).type.to_pandas_dtype()), name, path)
        check_columns(file, names, path)
        table = file.read(columns=names)
    return {name.lower(): _numbers(table[name].to_numpy(), name, path) for name in names}


def _crs_of(path: Path) -> Any:
    """The CRS of GeoParquet's primary geometry, unchecked; None if it has none, or the file is plain Parquet."""
    with open_parquet(path) as file:
        metadata = (file.schema_arrow.metadata or {}).get(b"geo")
    if metadata is None:
        return None
    geo = json.loads(metadata)
    return geo["columns"][geo["primary_column"]].get("crs", WORLD)


def _npz(path: Path, column_names: tuple[str, ...]) -> dict[str, np.ndarray]:
    return {name: _numbers(values, name, path) for name, values in npz_arrays(path, column_names).items()}


def _numbers(values: np.ndarray, name: str, path: Path) -> np.ndarray:
    _check_kind(values.dtype, name, path)
    if values.ndim != 1:
        raise InputError(f"{path.name}: column {name!r} must hold numbers, not arrays {values.shape}")
    return values.astype(np.float64)


def _check_kind(kind: np.dtype[Any], name: str, path: Path) -> None:
    if kind.kind not in "fiu":
        raise InputError(f"{path.name}: column {name!r} must hold numbers, not {kind}")
