"""Surfaces in tables: the building, surface, type, azimuth and tilt of each sensor, and tables with a row per group.

A group is a surface, a facade or a building, or the sensors with the same value in a column of the user, such as the
windows of a dwelling.
"""

from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import Any, NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray

from ...base.checks import quoted, spelling_hint
from ...base.errors import InputError
from ...base.wording import some_of
from ...engine.scene import AnyScene
from ...scene.units import LengthUnit
from ..cityjson.surface_types import WALL
from ..sensors.sensor_blocks import ChangedBlocks, DescribedSensors
from ..sensors.sensors import Sensors
from ..sensors.surface_groups import (
    SurfaceGroups,
    azimuths,
    buildings_of,
    checked_types,
    face_types,
    faces_between,
    notes_on_buildings,
    surface_groups,
    tilts,
)
from .result_table import Column, Table

NAMES = "building", "surface", "type", "azimuth", "tilt"
"""The columns of `surface_columns`."""

PER = "surface", "building", "facade"
"""Groups of sensors on faces."""

_ON_FACES = "face", "grid"

Judged: TypeAlias = Callable[[Mapping[str, Column], NDArray[np.integer], NDArray[np.float64]], dict[str, Column]]
"""(columns, row of each sensor, weight of each sensor) -> columns of rows that are no means, such as verdicts."""


class Between(NamedTuple):
    """Angles in degrees, both ends included."""

    first: float
    last: float


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
        if scene.city is not None or (sensors.kind in _ON_FACES and not scene.data.lacks_surfaces):
            about = "type of the surface, by its normal if the file names none"
            columns["type"] = Column(face_types(scene, faces), "", about)
    if sensors.normals is not None and sensors.kind != "raster":
        columns |= _directions(sensors.normals, scene.up, north)
    return columns


def surface_settings(scene: AnyScene) -> list[Any]:
    """What determines `surface_columns` besides triangles and sensors, for digests: arrays and JSON values."""
    names, _, building_of = buildings_of(scene)
    city = [] if scene.city is None else [scene.city.surface_of_face, [each.type for each in scene.city.surfaces]]
    return [list(names), np.asarray(building_of), *city]


def _names(names: Sequence[str], numbers: NDArray[np.integer], about: str) -> Column:
    """A column of names; rows with the number -1 have none. The strings are shared, so a row takes 8 bytes."""
    return Column(np.array([*names, ""], object)[numbers], "", about)


def _directions(normals: NDArray[np.float64], up: str, north: float) -> dict[str, Column]:
    return {
        "azimuth": Column(azimuths(normals, up, north), "degrees", "faces, clockwise from true north"),
        "tilt": Column(tilts(normals, up), "degrees", "of the surface: 0 faces up, 90 is vertical"),
    }


class SurfaceChoice(NamedTuple):
    """The sensors on surfaces of some types, with an azimuth and a tilt in a range; None: any."""

    types: Sequence[str] | None
    facing: Facing | None
    tilt: Between | None
    north: float

    def of(self, scene: AnyScene, sensors: Sensors) -> Sensors:
        """The sensors that are left. InputError if the scene has no surfaces of a type, or none is left."""
        chosen = self._some(scene, sensors)
        self.check(scene, len(chosen), len(sensors))
        return chosen

    def of_blocks(self, scene: AnyScene, source: DescribedSensors) -> DescribedSensors:
        """The sensors that are left, by block; `check` them when their number is known."""
        if all(each is None for each in self[:3]):
            return source
        by = [None if each is None else list(each) for each in self[:3]]
        self._some(scene, source.block(0, 0))  # refuses sensors without faces or normals
        return ChangedBlocks(source, partial(self._some, scene), [*by, self.north])

    def check(self, scene: AnyScene, left: int, before: int) -> None:
        """Raise an InputError if no sensor is left."""
        if left or not before:
            return
        limits = [f"of type {', '.join(self.types)}"] if self.types is not None else []
        limits += [f"facing {self.facing.first:g}:{self.facing.last:g}"] if self.facing is not None else []
        limits += [f"with a tilt in {self.tilt.first:g}:{self.tilt.last:g}"] if self.tilt is not None else []
        raise InputError(f"{scene.name} has no sensors {' '.join(limits)}; choose other surfaces")

    def _some(self, scene: AnyScene, sensors: Sensors) -> Sensors:
        types, facing, tilt, chosen = self.types, self.facing, self.tilt, np.ones(len(sensors), bool)
        if types is not None:
            names = checked_types(scene, types)
            if sensors.faces is None or sensors.kind == "vertex":
                raise InputError(f"surfaces need sensors on faces, unlike {sensors.kind!r}; use face, grid or raster")
            chosen &= np.isin(face_types(scene, sensors.faces), names)
        for name, angles in (("facing", facing), ("tilt", tilt)):
            if angles is not None and (sensors.normals is None or sensors.kind == "raster"):
                have = f"unlike {sensors.kind!r}; use face, vertex or grid"
                raise InputError(f"{name} needs sensors with normals, {have}")
        if facing is not None:
            chosen &= faces_between(azimuths(_normals(sensors), scene.up, self.north), *facing)
        if tilt is not None:
            degrees = tilts(_normals(sensors), scene.up)
            chosen &= (degrees >= tilt.first - _ROUNDING) & (degrees <= tilt.last + _ROUNDING)
        return sensors if chosen.all() else sensors.take(np.flatnonzero(chosen))


def _normals(sensors: Sensors) -> NDArray[np.float64]:
    assert sensors.normals is not None
    return sensors.normals


_ROUNDING = 1e-3  # degrees: the arc cosine of a normal nearly along the axis

# --- One row per surface, building, or value of a column --------------------------------------------------------------


def check_per(per: str, sensors: Sensors, scene: AnyScene) -> None:
    """Raise an InputError, before a study, unless `per_group` can make the rows from these sensors."""
    on_faces = sensors.faces is not None and sensors.areas is not None and sensors.kind != "vertex"
    if per not in ("sensor", *PER, *sensors.attributes):
        known = ["sensor", *PER, *sensors.attributes]
        hint = spelling_hint(per, known)
        raise InputError(f"per is {quoted(per)}, and sensors have no such column; {hint}use {', '.join(known)}")
    if per in PER and per not in sensors.attributes and not on_faces:
        raise InputError(
            f"rows per {per} need sensors on faces, unlike {sensors.kind!r}; use face, grid or raster, or points with "
            f"a column {per}"
        )
    if per not in PER or per in sensors.attributes or not len(sensors):
        return
    assert sensors.faces is not None
    if per == "building":
        surface_groups(scene, per)  # refuses scenes without buildings
    else:
        types = face_types(scene, np.unique(sensors.faces))
        if per == "facade" and not (types == WALL).any():
            raise InputError(f"per is {per!r}, and no sensor lies on a wall; use other sensors, or {PER[0]}")


def notes_on_rows(sensors: Sensors, per: str, scene: AnyScene) -> list[str]:
    """A note if sensors have no value in the column by which rows are grouped, or objects may be no buildings."""
    if per not in sensors.attributes:
        return notes_on_buildings(scene, per)
    count = int((_numbers(sensors.attributes[per]) < 0).sum())
    return [f"{some_of(count, len(sensors), 'sensor', 'have')} no {per}, and thus no row"] if count else []


def per_group(table: Table, per: str, north: float, judged: Judged | None = None) -> Table:
    """A table with a row for each surface, facade, building, or value of a column of the user, that has sensors.

    Numbers become means, over the area that the sensors represent if they have areas. The first sun is the earliest of
    all sensors, the last sun the latest. Numbers per square metre also get a column with their sum over the area. Other
    columns of the user come through if their values agree within each row.

    per : "surface", "facade", "building", or the name of an attribute of the sensors; a column comes first
    judged : gives columns that are no means

    Raises
    ------
    InputError
        If the sensors neither have such a column nor lie on faces with areas.
    """
    sensors, scene = table.sensors, table.scene
    assert scene is not None
    check_per(per, sensors, scene)
    groups = None if per in sensors.attributes else surface_groups(scene, per)
    numbers = _numbers(sensors.attributes[per]) if groups is None else _groups_of(groups, sensors)
    on = np.flatnonzero(numbers >= 0)
    used, row = np.unique(numbers[on], return_inverse=True)
    weights = np.ones(len(on)) if sensors.areas is None else sensors.areas[on]
    rows = _GroupRows(row, weights, len(used), scene.unit)
    values = {name: each._replace(values=each.values[on]) for name, each in table.columns.items() if name not in NAMES}
    columns = {} if judged is None else judged(values, row, weights)
    means = dict[str, Column]()
    for name, column in values.items():
        means |= {} if name in columns else rows.columns(name, column, sensors.areas is not None)
    columns |= means
    columns["sensors"] = Column(np.bincount(row, minlength=len(used)), "", f"number of sensors of the {per}")
    attributes = {name: _shared(each[on], row, len(used)) for name, each in sensors.attributes.items()}
    known = {name: each for name, each in attributes.items() if each is not None}
    about = {**table.about, "per": per}
    if groups is None:
        areas = None if sensors.areas is None else rows.total
        middles = Sensors(rows.means(sensors.points[on]), None, areas, None, "points", attributes=known)
        return Table(middles, columns, about, scene, table.camera, table.marks)
    assert sensors.faces is not None
    columns |= _group_columns(scene, per, groups, used)
    if per in ("surface", "facade") and sensors.normals is not None and sensors.kind != "raster":
        mean = rows.means(sensors.normals[on])
        length = np.linalg.norm(mean, axis=1, keepdims=True)
        sure = length[:, 0] > _LEAST_MEAN
        normals = np.divide(mean, length, out=np.full_like(mean, np.nan), where=sure[:, None])
        columns |= _directions(normals, scene.up, north)
    middles = Sensors(rows.means(sensors.points[on]), None, rows.total, None, "points", attributes=known)
    row_of_face = np.full(scene.n_triangles, -1, np.int64)
    row_of_face[sensors.faces[on]] = row
    return Table(middles, columns, about, scene, table.camera, table.marks, row_of_face)


def _groups_of(groups: SurfaceGroups, sensors: Sensors) -> NDArray[np.int64]:
    """(n,) int64: the group of each sensor, -1: none."""
    assert sensors.faces is not None
    return np.asarray(np.append(groups.of_face, -1).astype(np.int64)[sensors.faces])


def _numbers(values: np.ndarray) -> NDArray[np.int64]:
    """(n,) int64: numbers of the values of a column, in the order in which they first appear; -1: no value."""
    missing = np.array([each == "" for each in values], bool) if values.dtype.kind == "O" else values != values
    numbers = np.full(len(values), -1, np.int64)
    _, first, of_value = np.unique(values[~missing], return_index=True, return_inverse=True)
    numbers[~missing] = np.argsort(np.argsort(first))[of_value.reshape(-1)]
    return numbers


def _shared(values: np.ndarray, row: NDArray[np.integer], count: int) -> np.ndarray | None:
    """(rows,) of the value that all sensors of each row have; None if those of a row differ."""
    first = np.full(count, len(values), np.int64)
    np.minimum.at(first, row, np.arange(len(values)))
    shared = values[first]
    same = (values == shared[row]) | ((values != values) & (shared[row] != shared[row]))
    return shared if np.all(same) else None


_LEAST_MEAN = 1e-3  # length of the mean of unit normals below which they cancel out


def _group_columns(scene: AnyScene, per: str, groups: SurfaceGroups, used: NDArray[np.integer]) -> dict[str, Column]:
    """The names and types of the groups in use."""
    if per == "building":
        columns = {"building": _names(groups.names, used, "outermost object")}
        return columns | ({"type": _names(groups.types, used, "type of the object")} if any(groups.types) else {})
    one_face = np.unique(groups.of_face, return_index=True)[1][used]  # a face of each group
    names, _, building_of = buildings_of(scene)
    columns = {"building": _names(names, building_of[scene.object_of_face[one_face]], "outermost object")}
    columns["type"] = _names(groups.types, used, "type of the surface, by its normal if the file names none")
    if per == "facade":
        return {"facade": _names(groups.names, used, "object, and number of its facade")} | columns
    if scene.city is None:
        return columns | {"surface": Column(used.astype(np.int64), "", "index of the planar part")}
    surfaces = np.full(len(groups.names), len(scene.city.surfaces), np.int64)
    np.minimum.at(surfaces, groups.of_face, scene.city.surface_of_face)
    return columns | {"surface": Column(surfaces[used], "", "index in Scene.city.surfaces")}


class _GroupRows:
    """Sums over the sensors of each row.

    row : (n,) int, the row of each sensor
    areas : (n,) float64, or other weights
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

    def columns(self, name: str, column: Column, by_area: bool) -> dict[str, Column]:
        """The columns of rows for a column of sensors."""
        values, unit, about = column
        if values.dtype.kind == "M":
            return {name: Column(self._extreme(values, name.startswith("last")), unit, about)}
        means = self.means(values)
        columns = {name: Column(means, unit, f"{about}; mean{' over the area' if by_area else ''}")}
        if by_area and unit.endswith("/m2") and "_m2" in name:
            columns[name.replace("_m2", "", 1)] = Column(
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
