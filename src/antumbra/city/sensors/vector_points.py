"""Points of vector files, such as GeoPackage and GeoJSON, and the way of points into the CRS of a scene."""

from abc import abstractmethod
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...base.errors import InputError
from ...base.extras import import_extra
from ...engine.scene import AnyScene
from ...scene.crs import checked_crs, parts_of_crs, reproject
from ..gis.vector_files import BATCH, check_groups, layers_of, open_parquet, read_features, read_vectors
from .sensors import Sensors, point_sensors
from .table_rows import Batch, TableRows

SUFFIXES = (".gpkg", ".geojson", ".shp", ".fgb")
"""Suffixes of vector files of points."""

WORLD = "OGC:CRS84"
"""The CRS of columns in degrees, and of GeoParquet that names none."""

_AXES = "x", "y", "z"
_MOST_DEGREES = 360.0, 90.0
_KINDS = "fiubM"  # besides texts, of columns that come through


class PointFile(NamedTuple):
    """The points of a file in its own CRS."""

    sensors: Sensors
    name: str
    crs: Any = None  # anything that pyproj accepts; None: that of the scene
    on_map: bool = False  # easting, northing and height, whatever axis of the scene points up

    def within(self, scene: AnyScene) -> Sensors:
        """The points in the CRS and along the axes of a scene. Heights stay.

        Raises
        ------
        InputError
            If points are in degrees and the CRS of the scene is unknown, points have no coordinates in it, or points
            that have to be moved have normals.
        """
        crs = self._other_crs(scene)
        if crs is None and (scene.up == "z" or not self.on_map):
            return self.sensors
        turned, sign = ([0, 1, 2], 1.0) if scene.up == "z" else ([0, 2, 1], -1.0)
        at = self.sensors.points.copy() if self.on_map else self.sensors.points[:, turned] * [1.0, sign, 1.0]
        if crs is not None:
            assert scene.crs
            if self.sensors.normals is not None:
                raise InputError(
                    f"{self.name}: has normals, and its CRS is {crs}, the scene's {scene.crs}; reproject one of them"
                )
            try:
                at[:, :2] = reproject(at[:, :2], crs, scene.crs)
            except InputError as error:
                raise InputError(f"{self.name}: its CRS is {crs[:60]}, and {error}") from None
        return replace(self.sensors, points=(at * [1.0, sign, 1.0])[:, turned])

    def _other_crs(self, scene: AnyScene) -> str | None:
        """The CRS of the points; None if their coordinates are those of the scene."""
        if self.crs is None or not (scene.crs or self.on_map):
            return None
        crs = checked_crs(self.crs)
        plan = parts_of_crs(crs).plan
        if not scene.crs:
            if plan.is_geographic:
                raise InputError(f"{self.name}: is in degrees, and {scene.name} has no CRS; give it, as --crs does")
            return None
        return None if plan.equals(parts_of_crs(scene.crs).plan, ignore_axis_order=True) else crs


def read_vector_points(path: Path, flat: bool) -> PointFile:
    """The points of a vector file, with all columns as attributes.

    flat : whether heights may be missing, and are then 0

    Heights are those of the geometries, or of a column z.

    Raises
    ------
    InputError
        If the file cannot be read, has other geometries than points, or its points have no heights.
    """
    frame = read_vectors(path, "points", None if path.suffix.lower() == ".parquet" else _layer_of(path))
    return PointFile(_points_of(frame, path.name, flat), path.name, crs_of_frame(frame, path), True)


def crs_of_frame(frame: Any, path: Path) -> str | None:
    """The CRS of a GeoDataFrame of a file; None: unknown, as of GeoJSON without a CRS whose numbers are no degrees."""
    if frame.crs is None:
        return None
    crs = checked_crs(frame.crs)
    if path.suffix.lower() == ".geojson" and len(frame) and parts_of_crs(crs).plan.is_geographic:
        west, south, east, north = frame.total_bounds
        if max(-west, east) > _MOST_DEGREES[0] or max(-south, north) > _MOST_DEGREES[1]:
            return None
    return crs


def _layer_of(path: Path, whole: bool = True) -> str:
    """The only layer that may hold points; `whole`: whether its rows will be in memory at once."""
    kinds = layers_of(path, "points", whole)
    fitting = [name for name, kind in kinds.items() if "Point" in kind or "Unknown" in kind]
    if len(fitting) != 1:
        there = ", ".join(f"{name} ({kind})" for name, kind in kinds.items())
        raise InputError(
            f"{path.name}: has the layers {there or 'none'}; write one layer of points to a file of its own"
        )
    return fitting[0]


class GeometryRows(TableRows):
    """Points that are geometries, as by `read_vector_points`: their numbers are x, y and z."""

    crs: Any  # as of `PointFile`

    def __init__(self, path: Path):
        super().__init__(path)
        self.names = [*_AXES]
        self.select(_AXES)

    @abstractmethod
    def _frames(self, mark: Any) -> Iterator[tuple[Any, Any]]:
        """Yield marks, and the GeoDataFrame of the rows that are read there; at least one."""

    def _batches(self, mark: Any) -> Iterator[Batch]:
        row = 0
        for here, frame in self._frames(mark):
            sensors = _points_of(frame, self.path.name, False, row)
            yield Batch(here, sensors.points, sensors.attributes)
            row += len(frame)

    def _kinds_in(self, batch: Batch) -> dict[str, np.dtype[Any] | None]:
        return {name: values.dtype for name, values in batch.others.items()}

    def _attributes(self, batch: Batch) -> dict[str, NDArray[Any]]:
        return {name: batch.others[name].astype(kind) for name, kind in self._plain_kinds().items()}


class LayerRows(GeometryRows):
    """The only layer of a GeoPackage. Marks are the numbers of the features before them."""

    def __init__(self, path: Path):
        super().__init__(path)
        self._layer = _layer_of(path, whole=False)
        self.crs = crs_of_frame(read_features(path, "points", self._layer, None, 1), path)

    def _frames(self, mark: Any) -> Iterator[tuple[Any, Any]]:
        frame = None
        while frame is None or len(frame) == BATCH:
            frame = read_features(self.path, "points", self._layer, mark, BATCH)
            yield mark, frame
            mark = int(frame.index[-1]) if len(frame) else mark


class GeoParquetRows(GeometryRows):
    """GeoParquet with well-known binary in a column. Marks are the numbers of row groups."""

    def __init__(self, path: Path, column: str, crs: Any):
        super().__init__(path)
        self._column, self.crs = column, crs

    def _check_memory(self, whole: bool) -> None:
        with open_parquet(self.path, whole=whole) as file:
            check_groups(file, len(file.schema_arrow.names), self.path)

    def _frames(self, mark: Any) -> Iterator[tuple[Any, Any]]:
        none = True
        with open_parquet(self.path, whole=False) as file:
            for group in range(mark or 0, file.metadata.num_row_groups):
                for batch in file.iter_batches(BATCH, row_groups=[group]):
                    none = False
                    yield group, self._frame(batch)
            if none:
                yield 0, self._frame(file.schema_arrow.empty_table())

    def _frame(self, rows: Any) -> Any:
        geopandas = import_extra("geopandas", "points", "gis")
        shapely = import_extra("shapely", "points", "gis")
        frame = rows.to_pandas()
        return geopandas.GeoDataFrame(frame, geometry=shapely.from_wkb(frame.pop(self._column)))


def _points_of(frame: Any, file: str, flat: bool, first: int = 0) -> Sensors:
    """The points of a frame, whose rows are those of a file from `first` on."""
    shapely = import_extra("shapely", "points of vector files", "gis")
    shapes = np.asarray(frame.geometry.array, object)
    for k, shape in enumerate(shapes):
        if shape is None or shape.geom_type != "Point" or shape.is_empty:
            what = "nothing" if shape is None or shape.is_empty else f"a {shape.geom_type}"
            raise InputError(f"{file}: row {first + k + 1} is {what}, not a point; give a layer of points")
    at = shapely.get_coordinates(shapes, include_z=True).reshape(-1, 3)
    columns = {str(name): frame[name] for name in frame.columns if name != frame.geometry.name}
    heights = next((name for name in columns if name.lower() == "z"), None)
    level = np.isnan(at[:, 2])
    if level.any() and heights is not None:
        if columns[heights].dtype.kind not in "fiu":
            raise InputError(f"{file}: column {heights!r} must hold numbers")
        at[level, 2] = np.asarray(columns.pop(heights), np.float64)[level]
    elif level.any():
        if not flat:
            raise InputError(f"{file}: its points have no heights; add a column z, or place them with --on-surface")
        at[level, 2] = 0.0
    attributes = {name: values for name, column in columns.items() if (values := _values(column)) is not None}
    return replace(point_sensors(at), attributes=attributes)


def _values(column: Any) -> NDArray[Any] | None:
    """The numbers, times or texts of a column; None if it holds anything else."""
    if getattr(column.dtype, "kind", "O") in _KINDS and isinstance(column.dtype, np.dtype):
        kind: Any = {"i": np.int64, "u": np.int64, "f": np.float64}.get(column.dtype.kind)
        values = np.asarray(column)
        return values if kind is None else values.astype(kind)
    texts = column.astype(object).where(column.notna(), "").tolist()
    return np.array(texts, object) if all(isinstance(text, str) for text in texts) else None
