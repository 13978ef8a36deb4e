"""Results that know what they are: columns of numbers, one row for each sensor, with units and a place on the earth."""

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from ..checks import instance, points, quoted, spelling_hint
from ..engine.scene import AnyScene
from ..engine.scene_loading import scene_of
from ..errors import InputError
from ..scene.camera import Camera
from .formats import writer_of
from .sensorfields import check_on_scene
from .sensors import Sensors


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
