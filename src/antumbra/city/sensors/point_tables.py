"""Tables of points: which columns are positions, normals and areas; and sensors made of their rows, also by block."""

import hashlib
import json
import warnings
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...base.checks import points, unit_vectors
from ...base.errors import InputError
from ...engine.scene import AnyScene
from ...scene.rounded_coordinates import rounding_notes
from ..gis.vector_files import open_parquet
from .sensor_blocks import DescribedSensors
from .sensors import NORMAL_CURE, Sensors, point_sensors
from .table_rows import Rows, TableRows, reader_errors, table_rows
from .vector_points import WORLD, GeometryRows, GeoParquetRows, LayerRows, PointFile

_POSITION, _NORMAL = ("x", "y", "z"), ("nx", "ny", "nz")
_DEGREES = ("longitude", "latitude", "z"), ("lon", "lat", "z")
_SAMPLE = 64  # points of each batch that tell whether all were rounded


@dataclass(frozen=True)
class PointTable:
    """The points in a table.

    position : names of the columns of coordinates
    crs, on_map : as for `PointFile`
    """

    rows: TableRows
    position: Sequence[str]
    crs: Any
    on_map: bool

    @property
    def name(self) -> str:
        """The name of the file."""
        return self.rows.path.name

    @property
    def is_geometry(self) -> bool:
        """Whether the points are geometries."""
        return isinstance(self.rows, GeometryRows)

    @property
    def normals(self) -> list[int]:
        """The places of the components of normals among the columns in use; none if one is missing."""
        used = self.rows.used
        return [used.index(name) for name in _NORMAL] if set(_NORMAL) <= set(used) else []

    def whole(self) -> PointFile:
        """All points."""
        sensors = self.sensors(self.rows.whole())
        _warn_of_rounding(self.name, sensors.points)
        return PointFile(sensors, self.name, self.crs, self.on_map)

    def block(self, first: int, last: int) -> PointFile:
        """Some points of a surveyed table."""
        return PointFile(self.sensors(self.rows.rows(first, last)), self.name, self.crs, self.on_map)

    def sensors(self, rows: Rows) -> Sensors:
        """The sensors of some rows."""
        numbers, normals = rows.numbers, self.normals
        with _errors_of(self.name):
            sensors = point_sensors(self.at(numbers), numbers[:, normals] if normals else None, self._areas(numbers))
        return replace(sensors, attributes=rows.attributes)

    def at(self, numbers: NDArray[np.float64]) -> NDArray[np.float64]:
        """(n, 3) float64: the positions in the numbers of rows; heights that are missing are 0."""
        out = np.zeros((len(numbers), 3))
        for k, name in enumerate(self.position):
            if name in self.rows.used:
                out[:, k] = numbers[:, self.rows.used.index(name)]
        return out

    def _areas(self, numbers: NDArray[np.float64]) -> NDArray[np.float64] | None:
        return numbers[:, self.rows.used.index("area")] if "area" in self.rows.used else None

    def checked(self, first: int, numbers: NDArray[np.float64]) -> NDArray[np.float64]:
        """(k, 3) float64: the bounds of the rows from `first` on, and some of their positions.

        Raises the InputError of `sensors` if a row has no valid numbers.
        """
        at = self.at(numbers)
        bounds = np.array([[each.min(), each.max()] for each in at.T]).T if len(at) else np.empty((0, 3))
        with _errors_of(self.name):
            if not np.isfinite(bounds).all():
                points(at, "points of sensors", first)
            if self.normals:
                unit_vectors(numbers[:, self.normals], "the normal of sensor", NORMAL_CURE, first)
            if (areas := self._areas(numbers)) is not None:
                point_sensors(at, None, areas)
        return np.concatenate([bounds, at[:: -(-len(at) // _SAMPLE) or 1]])


@contextmanager
def _errors_of(file: str) -> Iterator[None]:
    """Let errors in the numbers of a file name it."""
    try:
        yield
    except InputError as error:
        raise InputError(f"{file}: {error}") from None


def point_table(path: Path, flat: bool = False) -> PointTable | None:
    """The points in a .csv, .parquet, .npz, .npy or .gpkg file; None if they are geometries of an uncommon encoding.

    flat : as for `antumbra.city.sensors.sensor_files.read_point_file`

    Raises
    ------
    InputError
        If the file cannot be read, a column of coordinates is missing, or a column in use holds no numbers.
    """
    if path.suffix.lower() == ".gpkg":
        layer = LayerRows(path)
        return PointTable(layer, _POSITION, layer.crs, True)
    rows, geo, crs = table_rows(path), None, None
    names, position, on_map = set(rows.names), _POSITION, False
    if path.suffix.lower() == ".parquet":
        with reader_errors(path):
            geo = _geometry_of(path)
            crs = None if geo is None else geo.crs
    if not {"x", "y"} & names:
        form = next((form for form in _DEGREES if set(form[:2]) <= names), None)
        if form is not None:
            position, crs, on_map = form, WORLD, True
        elif geo is not None and crs is not None:
            return PointTable(GeoParquetRows(path, geo.column, crs), _POSITION, crs, True) if geo.is_binary else None
    missing = [name for name in position if name not in names and not (flat and name == "z")]
    if missing:
        raise InputError(f"{path.name}: column {missing[0]!r} is missing; points need the columns x, y and z")
    rows.select((*position, *_NORMAL, "area"))
    return PointTable(rows, position, crs, on_map)


def crs_of_table(path: Path) -> Any:
    """The CRS of GeoParquet's primary geometry, unchecked; None if it has none, or the file is plain Parquet."""
    geometry = _geometry_of(path)
    return None if geometry is None else geometry.crs


class _Geometry(NamedTuple):
    """The primary geometry of GeoParquet."""

    column: str
    crs: Any  # unchecked
    is_binary: bool  # whether it is well-known binary


def _geometry_of(path: Path) -> _Geometry | None:
    with open_parquet(path, whole=False) as file:
        metadata = (file.schema_arrow.metadata or {}).get(b"geo")
    if metadata is None:
        return None
    geo = json.loads(metadata)
    about = geo["columns"][geo["primary_column"]]
    return _Geometry(geo["primary_column"], about.get("crs", WORLD), about.get("encoding") == "WKB")


@dataclass(frozen=True)
class FileBlocks(DescribedSensors):
    """The points of a surveyed table, in the CRS of a scene.

    digest : of the numbers in all rows
    """

    table: PointTable
    scene: AnyScene
    digest: str
    kind = "points"

    @classmethod
    def of(cls, table: PointTable, scene: AnyScene) -> "FileBlocks":
        """Survey a table.

        Raises
        ------
        InputError
            If the table cannot be read, a row has no valid numbers, or points cannot be moved into the scene's CRS.

        Warns
        -----
        UserWarning
            If coordinates were rounded, or columns are left out.
        """
        digest, sample = hashlib.sha256(), [np.empty((0, 3))]

        def visit(first: int, numbers: NDArray[np.float64]) -> None:
            sample.append(table.checked(first, numbers))
            digest.update(numbers.reshape(-1).data)

        table.rows.survey(visit)
        _warn_of_rounding(table.name, np.concatenate(sample))
        found = cls(table, scene, digest.hexdigest())
        found.block(0, 0)
        return found

    @property
    def sided(self) -> bool:  # type: ignore[override]
        return bool(self.table.normals)

    @property
    def description(self) -> list[Any]:
        table, scene = self.table, self.scene
        return [
            *("points", self.digest, table.rows.used, table.position, str(table.crs), table.on_map),
            *(scene.crs, scene.up),
        ]

    @property
    def attributes_description(self) -> list[Any]:
        with open(self.table.rows.path, "rb") as file:
            return [hashlib.file_digest(file, "sha256").hexdigest()]

    def __len__(self) -> int:
        return self.table.rows.n

    def block(self, first: int, last: int) -> Sensors:
        return self.table.block(first, last).within(self.scene)

    def whole(self) -> Sensors:
        return self.block(0, len(self))


def _warn_of_rounding(file: str, at: NDArray[np.float64]) -> None:
    """A note if float32 has rounded the points of a file; `at`: all, or some and the bounds."""
    if len(at) > 1:
        for note in rounding_notes(file, np.stack([at.min(0), at.max(0)]), lambda: at, "write it in float64"):
            warnings.warn(note, UserWarning, stacklevel=3)
