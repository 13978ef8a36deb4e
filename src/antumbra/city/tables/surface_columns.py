"""Surfaces in tables: the building, surface, type, azimuth and tilt of each sensor, and tables with a row per group."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...base.checks import quoted, spelling_hint
from ...base.errors import InputError
from ...engine.scene import AnyScene
from ...scene.units import LengthUnit
from ..sensors.sensors import Sensors
from ..sensors.surface_groups import (
    SurfaceGroups,
    azimuths,
    buildings_of,
    checked_types,
    faces_between,
    surface_groups,
    tilts,
)
from .result_table import Column, Table

NAMES = "building", "surface", "type", "azimuth", "tilt"
"""The columns of `surface_columns`."""

PER = "sensor", "surface", "building"
"""What the rows of a table may stand for, besides the values of a column of the file of the sensors."""

_ON_FACES = "face", "grid"


class Facing(NamedTuple):
    """Azimuths, degrees clockwise from true north, both ends included."""

    first: float
    last: float  # clockwise from `first`


# --- One row per sensor -----------------------------------------------------------------------------------------------


def surface_columns(scene: AnyScene, sensors: Sensors, north: float = 0.0) -> dict[str, Column]:
    """What is known of each sensor's surface.

    Names need sensors on faces; "surface" and "type" also a city model. Azimuth and tilt need normals.

    north : degrees, as `Place.north`
    """
    columns = {}
    if sensors.faces is not None and sensors.kind != "vertex":
        faces = sensors.faces
        names, _, building_of = buildings_of(scene)
        objects = np.asarray(scene.object_of_face[np.maximum(faces, 0)])
        columns["building"] = _names(names, np.where(faces < 0, -1, building_of[objects]), "outermost object")
        if scene.city is not None:
            surfaces = np.where(faces < 0, -1, scene.city.surface_of_face[np.maximum(faces, 0)])
            columns["surface"] = Column(surfaces, "", "index in Scene.city.surfaces")
            types = [each.type or "" for each in scene.city.surfaces]
            columns["type"] = _names(types, surfaces, "type of the semantic surface")
    if sensors.normals is not None and sensors.kind != "raster":
        columns |= _directions(sensors.normals, scene.up, north)
    return columns


def _names(names: Sequence[str], numbers: NDArray[np.integer], about: str) -> Column:
    """A column of names; rows with the number -1 have none. The strings are shared, so a row takes 8 bytes."""
    return Column(np.array([*names, ""], object)[numbers], "", about)


def _directions(normals: NDArray[np.float64], up: str, north: float) -> dict[str, Column]:
    return {
        "azimuth": Column(azimuths(normals, up, north), "degrees", "faces, clockwise from true north"),
        "tilt": Column(tilts(normals, up), "degrees", "of the surface: 0 faces up, 90 is vertical"),
    }


def chosen_sensors(
    scene: AnyScene, sensors: Sensors, types: Sequence[str] | None, facing: Facing | None, north: float
) -> Sensors:
    """The sensors on semantic surfaces of some types, and with an azimuth in a range; None: any.

    Raises
    ------
    InputError
        If the scene has no surfaces of a type, the sensors have no faces or normals, or none is left.
    """
    chosen = np.ones(len(sensors), bool)
    if types is not None:
        names = checked_types(scene, types)
        if sensors.faces is None or sensors.kind == "vertex":
            raise InputError(f"surfaces need sensors on faces, unlike {sensors.kind!r}; use face, grid or raster")
        assert scene.city is not None
        chosen &= np.isin(scene.city.surface_types(sensors.faces), names)
    if facing is not None:
        if sensors.normals is None or sensors.kind == "raster":
            raise InputError(f"facing needs sensors with normals, unlike {sensors.kind!r}; use face, vertex or grid")
        chosen &= faces_between(azimuths(sensors.normals, scene.up, north), *facing)
    if len(sensors) and not chosen.any():
        limits = [f"of type {', '.join(types)}"] if types is not None else []
        limits += [f"facing {facing.first:g}:{facing.last:g}"] if facing is not None else []
        raise InputError(f"{scene.name} has no sensors {' '.join(limits)}; choose other surfaces")
    return sensors if chosen.all() else sensors.take(np.flatnonzero(chosen))


# --- One row per surface or building ----------------------------------------------------------------------------------


def check_per(per: str, sensors: Sensors) -> None:
    """Raise an InputError, before a study, unless `per_group` can make the rows from these sensors."""
    if per not in PER and per not in sensors.attributes:
        known = [*PER, *sensors.attributes]
        hint = spelling_hint(per, known)
        raise InputError(f"per is {quoted(per)}, and sensors have no such column; {hint}use {', '.join(known)}")
    on_faces = sensors.faces is not None and sensors.areas is not None and sensors.kind != "vertex"
    if per in ("surface", "building") and not on_faces:
        raise InputError(f"rows per {per} need sensors on faces, unlike {sensors.kind!r}; use face, grid or raster")


def per_group(table: Table, per: str, north: float) -> Table:
    """A table with a row for each surface or building that has sensors.

    Numbers become means over the area that the sensors represent: a share of "passes" is a share of area. The first sun
    is the earliest of all sensors, the last sun the latest. Numbers per square metre also get a column with their sum
    over the area.

    per : "surface", "building", or an attribute of the sensors, such as the column "dwelling" of their file
    """
    sensors, scene = table.sensors, table.scene
    assert scene is not None
    if per not in PER:
        return _per_attribute(table, per)
    assert sensors.faces is not None and sensors.areas is not None  # checked before the study
    groups = surface_groups(scene, per)
    on = np.flatnonzero(sensors.faces >= 0)
    used, row = np.unique(groups.of_face[sensors.faces[on]], return_inverse=True)
    rows = _GroupRows(row, sensors.areas[on], len(used), scene.unit)
    columns: dict[str, Column] = {}
    for name, column in table.columns.items():
        if name not in NAMES:
            columns |= rows.columns(name, column._replace(values=column.values[on]))
    columns["sensors"] = Column(np.bincount(row, minlength=len(used)), "", f"number of sensors on the {per}")
    columns |= _group_columns(scene, per, groups, used)
    if per == "surface" and sensors.normals is not None and sensors.kind != "raster":
        mean = rows.means(sensors.normals[on])
        length = np.linalg.norm(mean, axis=1, keepdims=True)
        sure = length[:, 0] > _LEAST_MEAN
        normals = np.divide(mean, length, out=np.full_like(mean, np.nan), where=sure[:, None])
        columns |= _directions(normals, scene.up, north)
    middles = Sensors(rows.means(sensors.points[on]), None, rows.total, None, "points")
    row_of_face = np.full(scene.n_triangles, -1, np.int64)
    row_of_face[sensors.faces[on]] = row
    return Table(middles, columns, {**table.about, "per": per}, scene, table.camera, table.marks, row_of_face)


def _per_attribute(table: Table, per: str) -> Table:
    """A table with a row for each value of an attribute, in the order of the first sensors that have it.

    Sensors without areas count alike. Other attributes come through if they have one value in each row.
    """
    sensors, scene = table.sensors, table.scene
    assert scene is not None
    keys = sensors.attributes[per]
    found, first, row = np.unique(keys.astype(str) if keys.dtype == object else keys, return_index=True,
                                  return_inverse=True)  # fmt: skip
    order = np.argsort(first)
    rank = np.empty(len(found), np.int64)
    rank[order] = np.arange(len(found))
    row, first = rank[row.ravel()], first[order]
    areas = np.ones(len(sensors)) if sensors.areas is None else sensors.areas
    rows = _GroupRows(row, areas, len(found), scene.unit)
    columns: dict[str, Column] = {}
    for name, column in table.columns.items():
        if name not in NAMES:
            of_rows = rows.columns(name, column)
            columns |= of_rows if sensors.areas is not None else {name: of_rows[name]}
    columns["sensors"] = Column(np.bincount(row, minlength=len(found)), "", f"number of sensors of the {per}")
    attributes = {name: values[first] for name, values in sensors.attributes.items() if _is_one(values, first[row])}
    total = None if sensors.areas is None else rows.total
    middles = Sensors(rows.means(sensors.points), None, total, None, "points", attributes=attributes)
    return Table(middles, columns, {**table.about, "per": per}, scene, table.camera, table.marks)


def _is_one(values: np.ndarray, first: NDArray[np.integer]) -> bool:
    """Whether values, (n,), are those of the first sensors of their rows, (n,) indices; NaN and NaT are themselves."""
    same = values == values[first]
    if values.dtype.kind in "fM":
        same |= np.isnan(values) & np.isnan(values[first])
    return bool(np.all(same))


_LEAST_MEAN = 1e-3  # length of the mean of unit normals below which they cancel out


def _group_columns(scene: AnyScene, per: str, groups: SurfaceGroups, used: NDArray[np.integer]) -> dict[str, Column]:
    """The names and types of the groups in use."""
    if per == "building":
        columns = {"building": _names(groups.names, used, "outermost object")}
        return columns | ({"type": _names(groups.types, used, "type of the object")} if any(groups.types) else {})
    one_face = np.unique(groups.of_face, return_index=True)[1][used]  # a face of each group
    names, _, building_of = buildings_of(scene)
    columns = {"building": _names(names, building_of[scene.object_of_face[one_face]], "outermost object")}
    if scene.city is None:
        return columns | {"surface": Column(used.astype(np.int64), "", "index of the planar part")}
    surfaces = scene.city.surface_of_face[one_face].astype(np.int64)
    columns["surface"] = Column(surfaces, "", "index in Scene.city.surfaces")
    return columns | {"type": _names(groups.types, used, "type of the semantic surface")}


class _GroupRows:
    """Sums over the sensors of each row.

    row : (n,) int, the row of each sensor
    areas : (n,) float64
    count : number of rows
    unit : of the scene
    """

    def __init__(self, row: NDArray[np.integer], areas: NDArray[np.float64], count: int, unit: LengthUnit):
        self._row, self._areas, self._count, self._unit = row, areas, count, unit
        self.total = self._sums(areas)

    def _sums(self, values: NDArray[np.float64]) -> NDArray[np.float64]:
        return np.bincount(self._row, values, self._count).astype(np.float64)

    def means(self, values: np.ndarray) -> NDArray[np.float64]:
        """(rows,) or (rows, k) float64: means of values, (n,) or (n, k), over the area."""
        sums = [self._sums(column * self._areas) for column in np.atleast_2d(values.astype(np.float64).T)]
        with np.errstate(invalid="ignore"):
            means = np.stack(sums, -1) / self.total[:, None]
        return means if values.ndim == 2 else means[:, 0]

    def columns(self, name: str, column: Column) -> dict[str, Column]:
        """The columns of rows for a column of sensors."""
        values, unit, about = column
        if values.dtype.kind == "M":
            return {name: Column(self._extreme(values, name == "last"), unit, about)}
        means = self.means(values)
        columns = {name: Column(means, unit, f"{about}; mean over the area")}
        if unit.endswith("/m2") and name.endswith("_m2"):
            columns[name[: -len("_m2")]] = Column(
                means * self.total * self._unit.square_metres, unit.removesuffix("/m2"), f"{about}; sum over the area"
            )
        return columns

    def _extreme(self, times: np.ndarray, latest: bool) -> np.ndarray:
        """(rows,) datetime64: the earliest or latest time of each row, ignoring NaT; NaT only if every time is."""
        order = np.lexsort((times, self._row))  # NaT is last
        row, times = self._row[order], times[order]
        known = ~np.isnat(times)
        row, times = row[known], times[known]
        number = np.arange(self._count)
        at = np.searchsorted(row, number, "right") - 1 if latest else np.searchsorted(row, number)
        out = np.full(self._count, np.datetime64("NaT"), times.dtype)
        there = np.bincount(row, minlength=self._count) > 0
        out[there] = times[at[there]]
        return out
