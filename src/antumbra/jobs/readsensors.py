"""Sensors from text on a command line, and from files of points."""

import csv
import re
from pathlib import Path

import numpy as np

from ..checks import number
from ..errors import InputError
from ..extras import needed
from ..scene.any_scene import AnyScene
from ..scene.files import checked_file
from .sensors import Sensors, face_sensors, grid_sensors, point_sensors, raster_sensors, vertex_sensors

FORMS = "face, vertex, grid:SPACING, raster:SPACING[+HEIGHT|@HEIGHT], or a .csv, .parquet, .npy or .npz file"
SUFFIXES = (".csv", ".parquet", ".npy", ".npz")

_GRID = re.compile(r"grid:([0-9.eE+-]+)")
_RASTER = re.compile(r"raster:([0-9.]+(?:[eE][0-9-]+)?)(?:([+@])([0-9.eE+-]+))?")
_POSITION, _NORMAL = ("x", "y", "z"), ("nx", "ny", "nz")


def check_sensors(text: str) -> None:
    """Raise an InputError, before a scene is read, unless `sensors_of` knows this form."""
    if text in ("face", "vertex") or _GRID.fullmatch(text) or _RASTER.fullmatch(text):
        return
    path = Path(text)
    if path.suffix.lower() not in SUFFIXES:
        raise InputError(f"--sensors is {text!r}; it must be {FORMS}")
    checked_file(path, path.name)


def sensors_of(text: str, scene: AnyScene, threads: int | None = None) -> Sensors:
    """The sensors that a text names.

    - ``face``, ``vertex``: one for each face, or each place of corners
    - ``grid:1.5``: a grid on every surface
    - ``raster:2``, ``raster:2+1.6``, ``raster:2@30``: a horizontal raster on the highest surfaces, 1.6 above them,
      or at the coordinate 30
    - a file of points: see `read_points`
    """
    check_sensors(text)
    if text == "face":
        return face_sensors(scene)
    if text == "vertex":
        return vertex_sensors(scene)
    if grid := _GRID.fullmatch(text):
        return grid_sensors(scene, _number(grid[1], text))
    if raster := _RASTER.fullmatch(text):
        height = _number(raster[3], text) if raster[3] else 0.0
        return raster_sensors(scene, _number(raster[1], text), height, follow=raster[2] != "@", threads=threads)
    return read_points(Path(text))


def _number(text: str, whole: str) -> float:
    return number(text, f"a number of --sensors {whole}", -np.inf, np.inf)


def read_points(path: Path) -> Sensors:
    """Points from a file.

    - CSV with a header, Parquet, NPZ: columns or arrays x, y, z, and optionally nx, ny, nz, and area
    - NPY: (n, 3) points, or (n, 6) points and normals

    Raises
    ------
    InputError
        If the file cannot be read, or a column is missing or holds anything but numbers.
    """
    checked_file(path, path.name)
    suffix = path.suffix.lower()
    try:
        if suffix == ".npy":
            return _from_array(np.load(path, allow_pickle=False), path.name)
        columns = {".csv": _csv, ".parquet": _parquet, ".npz": _npz}[suffix](path)
    except InputError:
        raise
    except (OSError, ValueError, KeyError) as error:
        raise InputError(f"{path.name}: cannot be read ({' '.join(str(error).split())[:120]})") from error
    missing = [name for name in _POSITION if name not in columns]
    if missing:
        raise InputError(f"{path.name}: column {missing[0]!r} is missing; points need the columns x, y and z")
    normals = np.stack([columns[n] for n in _NORMAL], 1) if all(n in columns for n in _NORMAL) else None
    return point_sensors(np.stack([columns[n] for n in _POSITION], 1), normals, columns.get("area"))


def _from_array(array: np.ndarray, name: str) -> Sensors:
    if array.ndim != 2 or array.shape[1] not in (3, 6):
        raise InputError(f"{name}: the array has shape {array.shape}; points are (n, 3), points and normals (n, 6)")
    return point_sensors(array[:, :3], array[:, 3:] if array.shape[1] == 6 else None)


def _csv(path: Path) -> dict[str, np.ndarray]:
    with open(path, newline="", encoding="utf-8-sig") as file:
        rows = csv.reader(file)
        names = [name.strip().lower() for name in next(rows, [])]
        wanted = [(k, name) for k, name in enumerate(names) if name in (*_POSITION, *_NORMAL, "area")]
        values = []
        for line, row in enumerate(rows, 2):
            try:
                values.append([float(row[k]) for k, _ in wanted])
            except (ValueError, IndexError):
                shown = ",".join(row)[:60]
                raise InputError(f"{path.name}, line {line}: {shown!r} lacks a number of a point") from None
    table = np.array(values, np.float64).reshape(-1, len(wanted))
    return {name: table[:, k] for k, (_, name) in enumerate(wanted)}


def _parquet(path: Path) -> dict[str, np.ndarray]:
    needed("pyarrow", ".parquet", "gis")
    import pyarrow.parquet

    table = pyarrow.parquet.read_table(path)
    return {name: table[name].to_numpy() for name in table.column_names if name != "geometry"}


def _npz(path: Path) -> dict[str, np.ndarray]:
    with np.load(path, allow_pickle=False) as arrays:
        return {name: arrays[name] for name in arrays.files}
