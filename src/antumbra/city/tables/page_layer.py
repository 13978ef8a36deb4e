"""The layer of a page that shows a column of a table, with the scale of map sheets."""

from datetime import datetime
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...scene.camera import axes
from ...sun.location import Place
from ...web.value_layer import Stop, ValueLayer
from ..sensors.sensors import Sensors
from ..sheets.units_text import unit_text
from .false_colours import column_values, heading_of
from .map_legend import scale_of
from .map_scale import MapScale

_CELLS = 1.5  # widths of a cell: the sensors of a grid colour the surface so far around them, also on slopes
_DISC = 0.005  # of the diagonal of the scene: radius of the disc of a single point
_ABOVE = 0.01  # metres: where rays to the surface below begin, since sensors may lie on it
_DROP = 5.0  # metres: points without normals colour the surface below them, unless it is lower


def table_layer(table: Any, name: str) -> ValueLayer:
    """The numbers of a column of a `Table` on the surfaces of its scene."""
    values, known = column_values(table, name)
    values[~known] = np.nan
    sensors = table.sensors
    layer = layer_of(heading_of(table, name), unit_text(table.columns[name].unit), values, scale_of(table, name))
    if table.row_of_face is not None:
        return layer._replace(faces=table.row_of_face)
    if sensors.kind == "face":
        faces = np.full(table.scene.n_triangles, -1, np.int64)
        faces[sensors.faces] = np.arange(len(sensors))
        return layer._replace(faces=faces)
    if sensors.kind == "vertex":
        return layer._replace(corners=sensors.corners)
    layer = layer._replace(point_faces=sensors.faces if sensors.kind == "grid" else None)
    return layer._replace(points=_on_surfaces(table), normals=_sides(sensors, table.scene.up), reach=_reach(table))


def layer_of(name: str, unit: str, values: NDArray[np.float64], scale: MapScale) -> ValueLayer:
    """Numbers with the colours of a scale; the caller adds where they belong."""
    stops = [Stop(each.value, each.name, each.colour) for each in scale.stops()]
    ticks = [] if scale.classes else [(x, scale._replace(unit="").text(x)) for x in scale.ticks()]
    return ValueLayer(name, unit, values, stops, ticks, bool(scale.classes))


def place_in(about: dict[str, Any]) -> Place | None:
    """The place of a study; None if its metadata name none."""
    names = [name for name in Place._fields if name in about]
    return Place(**{name: about[name] for name in names}) if "latitude" in names else None


def moment_in(about: dict[str, Any]) -> str | datetime | None:
    """The moment or the first day of a study, in local time; None if its metadata name none."""
    if "time" in about and "sun_elevation" in about:  # of a shadow at a moment
        return datetime.fromisoformat(str(about["time"])).replace(tzinfo=None)
    return str(about["first"])[:10] if "first" in about else None


def _on_surfaces(table: Any) -> NDArray[np.float64]:
    """The points of sensors; of those without normals, such as people, the surface below them."""
    sensors, scene = table.sensors, table.scene
    if sensors.normals is not None and sensors.raster is None:
        return np.asarray(sensors.points)
    down = np.broadcast_to(-axes(scene.up)[1], sensors.points.shape)
    above = scene.unit.of_metres(_ABOVE)
    away = scene.closest_hit(sensors.points - above * down, down).t - above
    shift = np.where(away <= scene.unit.of_metres(_DROP), away, 0.0)
    return np.asarray(sensors.points + shift[:, None] * down)


def _sides(sensors: Sensors, up: str) -> NDArray[np.float64] | None:
    """The normals of sensors, with which they colour one side of a wall only; cells of rasters face up."""
    if sensors.raster is not None and sensors.normals is None:
        return np.broadcast_to(axes(up)[1], sensors.points.shape)
    return sensors.normals


def _reach(table: Any) -> float:
    """How far around a sensor the surface has its colour, in world units."""
    sensors, scene = table.sensors, table.scene
    if sensors.raster is not None:
        return float(_CELLS * sensors.raster.spacing)
    if sensors.areas is not None and len(sensors):
        return float(_CELLS * np.sqrt(np.max(sensors.areas)))
    return float(_DISC * np.linalg.norm(scene.bounds[1] - scene.bounds[0]))
