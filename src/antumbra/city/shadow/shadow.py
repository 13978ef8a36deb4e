"""`shadow`: the shadow on the ground at a moment, or the hours of shadow of days, as polygons."""

import warnings
from datetime import datetime
from fnmatch import fnmatchcase
from typing import Any, NamedTuple, ParamSpec

import numpy as np
from numpy.typing import NDArray

from ...base.errors import InputError
from ...base.extras import import_extra
from ...base.option_fields import Given, with_keywords
from ...base.progress import Progress, with_progress
from ...engine.measured_scenes import measured_scene
from ...engine.scene import AnyScene
from ...engine.scene_loading import SceneLike
from ...sun.location import UNKNOWN_PLACE, Place, place_in
from ...sun.sun_positions import Suns, directions_of, instant_of, months_of, solar_angles, zone_notes, zone_of
from ...work.executors import Executor, Keep, executor_of
from ...work.scene_records import scene_digest
from ...work.work_parts import Parts, about_parts
from ..sensors.sensors import Sensors, raster_sensors
from ..sun.sun_hours import sun_hours
from ..sun.sun_visibility import sum_suns, sun_query
from ..tables.polygon_files import outlines
from ..tables.result_table import Column, Table
from .plane_projection import Projection, polygons_of, projection_of, shadow_union, union_of
from .shadow_options import ShadowOptions
from .shadow_polygons import Shadow

_P = ParamSpec("_P")

GROUND = (
    "TINRelief", "LandUse", "PlantCover", "Road", "Railway", "TransportSquare", "Square", "Track", "WaterBody",
    "Waterway",
)  # fmt: skip
"""Types of city objects, or names, that are ground and cast no shadow on a plane unless they are listed as casters."""

_CELL = 1.0  # metres: default size of cells


@with_keywords(ShadowOptions, 1)
@with_progress
def shadow(
    given: Given[_P],
    scene: SceneLike,
    surface: "SceneLike | None" = None,
    keep: Keep = None,
    progress: Progress = None,
    *args: _P.args,
    **keywords: _P.kwargs,
) -> Shadow:
    """Find the shadow on the ground at a moment, or the shadow hours of days, as polygons.

    Without cells, the shadow at a moment falls on a horizontal plane, and its outline is exact: the union of all
    triangles, also of those with alpha masks, projected along the sun. With cells, polygons follow the edges of raster
    cells, whose centres are traced exactly, on the highest surfaces or on a plane. The sun is a point at its geometric
    position, without refraction.

    Parameters
    ----------
    scene : Scene, or anything that `antumbra.load` takes
        The triangles of a store fit in memory, or there are cells.
    surface : Scene, or anything that `antumbra.load` takes, optional
        The scene on whose highest surfaces cells lie: the one without trees, if `scene` has the trees of
        `antumbra.from_trees`. None: `scene`.
    keep : str, path-like or executor, optional
        Folder for the finished parts of an interrupted study, or an executor for the parts; see
        `antumbra.work.executors`.
    progress : function of (text, done, total), or bool, optional
        Called during the work. False: show nothing. None: terminals and notebooks show a bar after a second.

    Returns
    -------
    Shadow
        On a plane, a row for each connected shadow or each object, with its "area" (m2). With cells at a moment, a row
        for each connected shadow. For days, a row for each class: "hours_from", "hours_to" (exclusive, but for the last
        class, which ends with the hours of daylight) and "area". None if the executor leaves parts to other shards.

    Raises
    ------
    InputError
        If the place is unknown, the sun is below the horizon, an argument is invalid, or a package is missing
        (``antumbra[sun,gis]``).

    Examples
    --------
    >>> wall = at.Scene.from_arrays([[0, 0, 0], [9, 0, 0], [9, 0, 3], [0, 0, 3]], [[0, 1, 2], [0, 2, 3]], up="z")
    >>> cast = at.shadow(wall, at="2026-06-21T12:00", place=at.Place(52, 4.4, timezone="Europe/Amsterdam"), plane=0)
    >>> cast.columns["area"].round(1)
    array([13.3])
    """
    options, scene = ShadowOptions(**given(*args, **keywords)), measured_scene(scene)
    options.check_moment()
    executor = executor_of(keep)
    import_extra("shapely", "shadow", "gis")
    place = place_in(scene, options.place)
    if place is None:
        raise InputError(f"{UNKNOWN_PLACE}, or a CRS")
    below = scene if surface is None else measured_scene(surface)
    if options.days is not None:
        found = _hours(scene, _cells(below, options), place, options, executor)
    else:
        moment = _moment_of(scene, place, options)
        if options.on_plane:
            found = _on_plane(scene, moment, options, executor)
        else:
            found = _on_cells(scene, below, moment, options, executor)
    return found  # type: ignore[return-value]  # None: a shard, of a command


class _Moment(NamedTuple):
    """The sun at a moment."""

    suns: Suns  # one sun, of an hour
    about: dict[str, Any]


def _moment_of(scene: AnyScene, place: Place, options: ShadowOptions) -> _Moment:
    when = options.at
    assert isinstance(when, datetime)
    zone = zone_of(place)
    instant = np.array([instant_of(when, zone).replace(tzinfo=None)], "datetime64[s]")
    when = when.replace(tzinfo=zone) if when.tzinfo is None else when
    for note in zone_notes(place, instant[0]):
        warnings.warn(note, UserWarning, stacklevel=4)
    altitude, azimuth = solar_angles(place, instant)
    if not altitude[0] > 0.0:
        raise InputError(
            f"at {when.isoformat()}, the sun is {-altitude[0]:.1f} degrees below the horizon; choose a day time"
        )
    directions = directions_of(altitude, azimuth + place.north, scene.up)
    local = np.array([when.replace(tzinfo=None)], "datetime64[s]")
    about: dict[str, Any] = {"job": "shadow", "scene": scene.name, **place._asdict(), "time": when.isoformat()}
    about |= {"length_unit": scene.unit.name, "up": scene.up}
    about |= {"sun_azimuth": float(azimuth[0]), "sun_elevation": float(altitude[0])}
    if scene.crs:
        about["crs"] = scene.crs
    return _Moment(Suns(instant, local, np.ones(1), directions, altitude, azimuth), about)


# --- On a plane -------------------------------------------------------------------------------------------------------


GROUPS_PER_PART = 256  # objects that cast a shadow


def _on_plane(scene: AnyScene, moment: _Moment, options: ShadowOptions, executor: Executor) -> Shadow | None:
    """The exact outline of the shadow on a plane."""
    corners = _on_map(scene, scene.triangles(threads=options.threads).vertices.astype(np.float64) + scene.origin)
    height = float(corners[..., 2].min()) if options.plane is None else options.plane
    projection = projection_of(_on_map(scene, moment.suns.directions)[0], height)
    groups = _casters(scene, options.casters)
    apart = options.per == "object"

    def work(first: int, last: int) -> dict[str, np.ndarray]:
        shapes = []
        for _, _, faces in groups[first:last]:
            shape = shadow_union(corners[faces], projection)
            shapes.append(_beside(shape, corners[faces], height) if apart and not options.footprints else shape)
        return _packed(shapes)

    settings = moment.suns.directions, height, options.casters, options.per, options.footprints
    parts_about = None
    if executor.folder is not None:
        parts_about = about_parts("shadow on a plane", scene_digest(scene, 0.0, options.threads), *settings)
    parts = Parts("projecting shadows", len(groups), GROUPS_PER_PART, work, executor.folder, parts_about)
    if not executor.finish([parts]):
        return None
    unpacked = [shape for k in range(len(parts)) for shape in _unpacked(parts[k])]
    executor.end([parts])
    rows = [(shape, name, kind) for shape, (name, kind, _) in zip(unpacked, groups) if not shape.is_empty]
    about = {**moment.about, "height": height}
    casters = corners[np.concatenate([np.empty(0, np.int64), *(faces for _, _, faces in groups)])]
    plan = casters[(casters[..., 2] > height).any(1), :, :2]
    shapes = [shape for shape, _, _ in rows]
    if apart:
        columns = {"object": np.array([name for _, name, _ in rows], object)}
        columns["type"] = np.array([kind for _, _, kind in rows], object)
        return _shadow_of(scene, shapes, columns, about)._replace(casters=plan)
    joined = union_of([part for shape in shapes for part in shape.geoms])
    if not options.footprints:
        joined = _beside(joined, casters, height)
    return _shadow_of(scene, list(joined.geoms), {}, about)._replace(casters=plan)


def _packed(shapes: list[Any]) -> dict[str, np.ndarray]:
    """Shapes as arrays: well-known binary, and where each ends."""
    texts = [shape.wkb for shape in shapes]
    return {"wkb": np.frombuffer(b"".join(texts), np.uint8), "ends": np.cumsum([len(text) for text in texts])}


def _unpacked(arrays: dict[str, np.ndarray]) -> list[Any]:
    """The shapes of `_packed`."""
    from shapely import from_wkb

    return [from_wkb(text.tobytes()) for text in np.split(arrays["wkb"], arrays["ends"])[:-1]]


def _beside(shape: Any, corners: NDArray[np.float64], height: float) -> Any:
    """The part of a shadow that is not straight below triangles."""
    return polygons_of(shape.difference(shadow_union(corners, Projection(height, (0.0, 0.0)))))


def _casters(scene: AnyScene, patterns: Any) -> list[tuple[str, str, NDArray[np.int64]]]:
    """(name, type, faces) of each outermost object that casts a shadow.

    Raises
    ------
    InputError
        If no object matches.
    """
    names = [each.parent or each.name for each in scene.objects]
    types = [each.type for each in scene.objects]
    if patterns is None:
        chosen = [each.type not in GROUND and each.name not in GROUND for each in scene.objects]
    else:
        chosen = [
            any(
                fnmatchcase(word, pattern)
                for pattern in patterns
                for word in (each.name, each.parent, each.type)
                if word
            )
            for each in scene.objects
        ]
        if not any(chosen):
            known = sorted({kind for kind in types if kind} or set(names))[:6]
            raise InputError(f"casters is {','.join(patterns)!r}, and no object matches; there are {', '.join(known)}")
    order = np.argsort(scene.object_of_face, kind="stable")
    ends = np.searchsorted(scene.object_of_face[order], np.arange(len(names) + 1))
    groups: dict[str, tuple[str, list[np.ndarray]]] = {}
    for k, (name, kind) in enumerate(zip(names, types)):
        if chosen[k]:
            groups.setdefault(name, (kind, []))[1].append(order[ends[k] : ends[k + 1]])
    return [(name, kind, np.concatenate(faces)) for name, (kind, faces) in groups.items()]


def _on_map(scene: AnyScene, vectors: NDArray[np.float64]) -> NDArray[np.float64]:
    """Vectors (..., 3) as easting, northing and height."""
    return vectors if scene.up == "z" else vectors[..., [0, 2, 1]] * [1.0, -1.0, 1.0]


# --- On cells ---------------------------------------------------------------------------------------------------------


def _on_cells(
    scene: AnyScene, below: AnyScene, moment: _Moment, options: ShadowOptions, executor: Executor
) -> Shadow | None:
    """The cells in shadow at a moment, on the surfaces of the scene `below`."""
    sensors = _cells(below, options)
    bins, months = np.empty((1, 0), np.int64), months_of(moment.suns.local)
    query = sun_query(scene, sensors, moment.suns, bins, 1, months=months, plan=options.plan, threads=options.threads)
    tally = sum_suns(query, executor, "shadow")
    if tally is None:
        return None
    hidden = 1.0 - tally.hours
    about = {**moment.about, "cell": options.cell}
    table = Table(sensors, {"shadow": Column(hidden, "", "share of the sun's light that is blocked")}, about, scene)
    values = sensors.on_raster(hidden)
    assert sensors.raster is not None
    shapes = outlines(np.where(values >= 0.5, 0, -1).astype(np.int16), sensors.raster)
    parts = [part for _, shape in shapes for part in shape.geoms]
    return _shadow_of(scene, parts, {}, table.about, table)


def _hours(
    scene: AnyScene, sensors: Sensors, place: Place, options: ShadowOptions, executor: Executor
) -> Shadow | None:
    """The classes of hours of shadow on days."""
    settings: dict[str, Any] = {"step": options.step, "plan": options.plan, "threads": options.threads}
    table: Table | None = sun_hours(scene, sensors, options.days, place=place, keep=executor, **settings)
    if table is None:
        return None
    hours = np.maximum(table.about["hours"] - table["sun_hours"], 0.0)
    table.columns = {
        "shadow_hours": Column(hours, "h", "hours with the sun above the horizon, but hidden"),
        **table.columns,
    }
    first, last = table.about["first"][:10], table.about["last"][:10]
    days = first if first == last else f"{first}:{last}"
    table.about |= {
        "job": "shadow",
        "scene": scene.name,
        "days": days,
        "cell": sensors.raster and sensors.raster.spacing,
    }
    limits = np.array(options.classes, np.float64)
    values = sensors.on_raster(hours)
    # Sums of intervals may fall short of a whole number by their rounding.
    classes = np.where(np.isnan(values), -1, np.searchsorted(limits, values + 1e-9, side="right") - 1)
    assert sensors.raster is not None
    shapes = outlines(classes.astype(np.int16), sensors.raster)
    which = np.array([k for k, _ in shapes], np.int64)
    most = max(float(table.about["hours"]), limits[-1])
    columns = {"hours_from": limits[which], "hours_to": np.append(limits[1:], most)[which]}
    return _shadow_of(scene, [shape for _, shape in shapes], columns, table.about, table)


def _cells(scene: AnyScene, options: ShadowOptions) -> Sensors:
    cell, height = options.cell or scene.unit.of_metres(_CELL), options.plane
    if height is None:
        return raster_sensors(scene, cell, threads=options.threads)
    return raster_sensors(scene, cell, height, follow=False, threads=options.threads)


def _shadow_of(
    scene: AnyScene,
    shapes: list[Any],
    columns: dict[str, np.ndarray],
    about: dict[str, Any],
    table: Table | None = None,
) -> Shadow:
    polygons = np.empty(len(shapes), object)
    polygons[:] = shapes
    areas = np.array([shape.area for shape in shapes], np.float64) * scene.unit.square_metres
    return Shadow(polygons, {**columns, "area": areas}, about, table, scene=scene)
