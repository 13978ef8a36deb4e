"""`viewshed`: how many observers see each sensor, and which; with distance and angle limits, and earth curvature."""

import os
from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, NamedTuple, ParamSpec

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ...base.errors import InputError
from ...base.extras import import_extra
from ...base.option_fields import Given, with_keywords
from ...base.progress import Progress, report_progress, with_progress
from ...engine.measured_scenes import measured_scene
from ...engine.scene import AnyScene
from ...engine.scene_loading import SceneLike
from ...kernels.parallel import thread_count
from ...query.query_bounds import morton_codes
from ...query.receivers import Receivers
from ...scene.lights import MAX_SPP
from ...trace.terrain.terrain_views import SEEN, UNDECIDED
from ...work.result_summary import Summary
from ..sensors.curved_earth import Earth, curvature_record, earth_of, lowered_scene
from ..sensors.point_checks import notes_on_bare_points, notes_on_points, notes_on_sensors, tell
from ..sensors.sensor_files import sensors_of
from ..sensors.sensors import Sensors, point_sensors, sensors_from, sightline_ends
from ..tables.bit_matrices import unpack_bits, words_of
from ..tables.polygon_files import check_polygon_output, level_crs, outlines, write_polygons
from ..tables.result_table import Column, Table
from .least_heights import check_own_cells, least_heights_of
from .line_points import LinePoints
from .observers import Observers, observers_of
from .viewshed_options import ViewshedOptions
from .visibility_matrix import TileTracer

if TYPE_CHECKING:
    import geopandas

_P = ParamSpec("_P")


# --- Viewsheds --------------------------------------------------------------------------------------------------------


MAX_PAIRS = 1 << 22  # pairs of sensors and observers unpacked at a time
_MOST = 1 << 31  # maximum bytes of bits


class Viewshed(NamedTuple):
    """What observers see of a scene."""

    table: Table  # one row per sensor: seen, first, nearest, distance
    observers: np.ndarray  # (k, 3) float64, world: the observers' eyes
    bits: np.ndarray | None  # (n, ceil(k / 64)) uint64: bit j of row i: observer j sees sensor i; None: not requested
    names: tuple[str, ...] = ()  # of the observers: ids of their table, or numbers from 1

    def polygons(self) -> "geopandas.GeoDataFrame":
        """The cells that each observer sees, as a row with a polygon of several parts, in the CRS of the scene.

        The columns are ``observer``, its name; ``x``, ``y`` and ``z``, its eye; and ``area``, m2. It needs ``each``,
        cells of a raster, and ``antumbra[gis]``.

        Raises
        ------
        InputError
            If the study was made without ``each``, or the sensors form no raster.
        """
        return seen_polygons(self)

    def save_polygons(self, path: str | os.PathLike[str]) -> None:
        """Write `polygons` as .gpkg, .geojson (in WGS 84 if the CRS is known) or .parquet (GeoParquet).

        Raises
        ------
        InputError
            As for `polygons`, or if the path cannot be written.
        """
        target = check_polygon_output(path)
        write_polygons(target, self.polygons(), "viewshed")

    def summary(self, scene: str, seconds: float) -> Summary:
        """How many sensors are seen, and their area; `seconds`: of the study."""
        table, counted = self.table, self.table.sensors.covered
        visible, n = table["seen"][counted] > 0, int(counted.sum())
        values: dict[str, Any] = {"scene": scene, "sensors": n, "observers": len(self.observers)}
        values |= {"seen": int(visible.sum()), "seconds": seconds}
        share = 100.0 * values["seen"] / max(n, 1)
        lines = [("sensors", f"{n:,}"), ("observers", f"{len(self.observers):,}")]
        lines.append(("seen by any", f"{values['seen']:,} ({share:.1f} %)"))
        if table.sensors.areas is not None:
            assert table.scene is not None
            areas = table.sensors.areas[counted] * table.scene.unit.square_metres
            values |= {"area": float(areas.sum()), "area_seen": float(areas[visible].sum())}
            lines.append(("area seen", f"{values['area_seen']:,.6g} of {values['area']:,.6g} m2"))
        return Summary(values, lines)


def seen_polygons(found: Viewshed) -> Any:
    """`Viewshed.polygons`."""
    geopandas = import_extra("geopandas", "polygons", "gis")
    table, raster = found.table, found.table.sensors.raster
    if raster is None or not all(f"seen_{name}" in table.columns for name in found.names):
        raise InputError("polygons need the cells of a raster, and a column for each observer; give each=True")
    shapely = import_extra("shapely", "polygons", "gis")
    shapes, areas = list[Any](), list[float]()
    unit = 1.0 if table.scene is None else table.scene.unit.square_metres
    for name in found.names:
        cells = table.sensors.on_raster(table[f"seen_{name}"])
        parts = outlines(np.where(cells == 1.0, 0, -1).astype(np.int16), raster)
        shapes.append(parts[0][1] if parts else shapely.MultiPolygon())
        areas.append(float(shapes[-1].area) * unit)
    columns = {"observer": found.names, **dict(zip("xyz", found.observers.T)), "area": areas}
    crs = table.about.get("crs")
    return geopandas.GeoDataFrame(columns, geometry=shapes, crs=None if crs is None else level_crs(crs))


class _Sight(NamedTuple):
    """The observers of each sensor; updated in place as pairs are traced."""

    observers: np.ndarray  # (n,) int32: number of observers
    first: np.ndarray  # (n,) int32: the lowest observer, k: none so far
    nearest: np.ndarray  # (n,) int32
    distance: np.ndarray  # (n,) float64, inf: none
    bits: np.ndarray | None  # (n, words) uint64
    length: np.ndarray | None  # (n,) float64: of the lines that see it; None: not requested
    least_height: np.ndarray | None  # (n,) float64, inf: none so far; None: not requested


@dataclass
class _ViewshedState:
    """A viewshed being computed."""

    sensors: Sensors
    observers: Observers
    up: str
    sight: _Sight
    lengths: np.ndarray | None  # (k,): of the line around each observer
    earth: Earth | None  # None: it is flat


@with_keywords(ViewshedOptions, 3)
@with_progress
def viewshed(
    given: Given[_P], scene: SceneLike, sensors: Sensors | str | ArrayLike, observers: ArrayLike | Sensors | LinePoints,
    surface: "SceneLike | None" = None, progress: Progress = None, *args: _P.args, **keywords: _P.kwargs,
) -> Viewshed:  # fmt: skip
    """Find which observers see each sensor: a cumulative viewshed. Every line of sight is exact.

    Parameters
    ----------
    scene : Scene, PagedScene, or anything that `antumbra.load` takes
    sensors : Sensors, str, or (n, 3) float
        The targets. A text is as in `antumbra.sensors_of`: ``"raster:2+1.6"`` places targets 1.6 above the highest
        surfaces, as ``at.raster_sensors(scene, 2.0, height=1.6)`` does. Sensors on surfaces, such as
        ``at.face_sensors(scene)``, are visible only from their outer side.
    observers : (3,) or (k, 3) float, Sensors, or LinePoints
        World coordinates, or the points along lines of `antumbra.points_along`. The attributes ``eye_height``,
        ``min_distance`` and ``max_distance`` of `Sensors` replace the options of these names, and ``id`` or ``name``
        names the observers; NaN stands for the option. `antumbra.sensors_of` reads files of points.
    surface : Scene, PagedScene, or anything that `antumbra.load` takes, optional
        The scene on which sensors and observers are placed, by a text or `on_surface`: the one without trees, if
        `scene` has the plants of `antumbra.from_trees`. None: `scene`.
    progress : function of (text, done, total), or bool, optional
        Called during the work. False: show nothing. None: terminals and notebooks show a bar after a second.

    Returns
    -------
    Viewshed
        The columns of its `table` are ``seen``, the number of observers; ``first``, the lowest of their indices, and
        ``nearest``, that of the nearest one, -1 where no observer sees the sensor; and ``distance`` to the nearest one,
        NaN where there is none. For lines, ``length`` is the length of the lines that see the sensor. With
        `least_height`, the column of this name is the least height above each cell at which a point is seen by any
        observer, 0 where the surface itself is seen; NaN where there is no surface, or every observer is excluded by
        a limit or below the surface. With `each`, a column ``seen_NAME`` for each observer.

    Raises
    ------
    InputError
        If an argument is invalid, there is no observer or no surface to place one on, points are in degrees, bits
        would take more than 2 GiB, or `least_height` is requested for anything but the cells of a scene that is a
        single raster of heights.

    Warns
    -----
    UserWarning
        If points lie beside the scene, below the ground, on a surface without a normal, or closely behind another one.

    Notes
    -----
    Sightlines are straight and exact. With `curvature`, points at a horizontal distance d from an observer are
    (1 - k) d^2 / (2 R) lower, as in GIS programs. Results are exact for the float32 vertices of a copy of the scene,
    lowered around its middle. It serves all observers, since another centre maps straight lines to straight lines.
    Edges are divided until they follow the curve within a millimetre, and sensors on faces are lifted by as much.

    Least heights are a closed form of the horizon profile, the maximum over all crossings of the line of sight with
    edges of triangles, in float64. They agree with exact lines of sight up to the float32 rounding of coordinates.
    With `curvature`, vertices are lowered and edges are not divided.
    """
    options, scene = ViewshedOptions(**given(*args, **keywords)), measured_scene(scene)
    earth = earth_of(options, scene)
    threads, time = thread_count(options.threads), scene.clamped(options.time)
    below = scene if surface is None else measured_scene(surface)
    checked = sensors_of(sensors, below, threads) if isinstance(sensors, str) else sensors
    targets = sensors_from(scene, checked, None, "sensors")
    along = observers if isinstance(observers, LinePoints) else None
    seers = observers_of(below, observers if along is None else along.points, options)
    eyes = seers.eyes
    notes = notes_on_sensors(below, targets, "sensors", time, threads)
    notes += notes_on_points(below, eyes, "observers", time, threads)
    warned = tell(notes + notes_on_bare_points(below, eyes, "observers", time, threads))
    if options.least_height:
        check_own_cells(scene, targets)
    n, k = len(targets), len(eyes)
    if options.bits and 8 * n * words_of(k) > _MOST:
        raise InputError(
            f"bits of {n} sensors and {k} observers take {n * k / 8e9:.1f} GB; visibility_matrix streams them"
        )
    if options.each and n * k > _MOST:
        raise InputError(
            f"columns of {n} sensors and {k} observers take {n * k / 1e9:.1f} GB; use bits instead of each"
        )
    keeps_bits = options.bits or options.each
    visibility_bits = np.zeros((n, words_of(k)), np.uint64) if keeps_bits else None
    no_observer = np.full(n, -1, np.int32)
    sight = _Sight(
        np.zeros(n, np.int32), np.full(n, k, np.int32), no_observer, np.full(n, np.inf), visibility_bits,
        None if along is None else np.zeros(n), np.full(n, np.inf) if options.least_height else None,
    )  # fmt: skip
    state = _ViewshedState(targets, seers, scene.up, sight, None if along is None else along.lengths, earth)
    recorded = ["eye_height", "min_distance", "max_distance", "azimuth", "elevation"]
    with report_progress(f"{n} sensors, {k} observers") as report:
        copy = scene if earth is None else lowered_scene(scene, earth, time)
        moment = time if earth is None else 0.0
        _trace(state, copy, TileTracer(copy, options.plan, moment, threads, n * k), report)
        if sight.least_height is not None:
            _find_least_heights(state, sight.least_height, scene, threads)
    about = {"job": "viewshed", "observers": k, **{name: getattr(options, name) for name in recorded}}
    about |= curvature_record(options, scene) | warned
    columns = _columns(sight, k, scene.unit.name)
    if options.each and visibility_bits is not None:
        columns |= {
            f"seen_{name}": Column(
                unpack_bits(visibility_bits[:, j // 64 : j // 64 + 1], 64)[:, j % 64], "", "seen by it"
            )
            for j, name in enumerate(seers.names)
        }
    table = Table(targets, columns, about, scene, marks=eyes)
    return Viewshed(table, eyes, visibility_bits if options.bits else None, seers.names)


def _columns(sight: _Sight, observers: int, unit: str) -> dict[str, Column]:
    visible = sight.observers > 0
    columns = {
        "seen": Column(sight.observers, "", f"observers that see it, of {observers}"),
        "first": Column(np.where(visible, sight.first, -1).astype(np.int32), "", "first observer that sees it"),
        "nearest": Column(sight.nearest, "", "nearest observer that sees it"),
        "distance": Column(np.where(visible, sight.distance, np.nan), unit, "distance to the nearest observer"),
    }
    if sight.length is not None:
        columns["length"] = Column(sight.length, unit, "length of the lines that see it")
    if sight.least_height is not None:
        heights = np.where(np.isfinite(sight.least_height), sight.least_height, np.nan)
        columns["least_height"] = Column(heights, unit, "least height above the cell at which a point is seen")
    return columns


def _trace(state: _ViewshedState, scene: AnyScene, tracing: TileTracer, progress: Callable[[int, int], object]) -> None:
    """Trace all observers in lists, and skip sensors beyond the reach of a list; scene: lowered on a curved earth."""
    observers = state.observers
    sensors, at = state.sensors, point_sensors(observers.eyes)
    if state.earth is not None:
        sensors, at = state.earth.lowered_sensors(sensors), state.earth.lowered_sensors(at)
    ends, eyes = sightline_ends(scene, sensors), sightline_ends(scene, at)
    order, curve = np.argsort(morton_codes(eyes.origins[0]), kind="stable"), np.arange(ends.n)
    order = np.array([k for k in order.tolist() if not _add_view(state, ends, eyes, k, tracing)], np.int64)
    in_rows = state.sensors.kind == "raster" and tracing.prefers_rows
    if not in_rows:
        curve = np.argsort(morton_codes(ends.origins[0]), kind="stable")
    for first in range(0, len(order), MAX_SPP):
        some = order[first : first + MAX_SPP]
        places = curve
        if (reach := observers.reach(some)) < np.inf:
            places = curve[_within(state.sensors.points[curve], observers.eyes[some], reach)]
        step = max(1024, MAX_PAIRS // len(some))
        for start in range(0, len(places), step):
            part = places[start : start + step]
            rows = ends.take(slice(start, start + step) if in_rows and places is curve else part)
            _add(state, part, some, tracing.visible(rows, eyes.take(some)))
            progress(first + len(some) * min(start + step, len(places)) // len(places), len(order))


def _add_view(state: _ViewshedState, ends: Receivers, eyes: Receivers, observer: int, tracing: TileTracer) -> bool:
    """Record what an observer sees of the cells of a raster of heights, by one sweep; whether that was possible."""
    alone = np.array([observer])
    classes = tracing.view(ends, eyes.origins[0, observer], state.observers.reach(alone))
    if classes is None:
        return False
    _add_seen(state, np.flatnonzero(classes == SEEN), observer)
    places = np.flatnonzero(classes == UNDECIDED)
    if (reach := state.observers.reach(alone)) < np.inf:
        places = places[_within(state.sensors.points[places], state.observers.eyes[alone], reach)]
    for start in range(0, len(places), MAX_PAIRS):
        part = places[start : start + MAX_PAIRS]
        _add(state, part, alone, tracing.visible(ends.take(part), eyes.take(alone)))
    return True


def _find_least_heights(state: _ViewshedState, best: np.ndarray, scene: AnyScene, threads: int) -> None:
    """Lower the least heights ((n,), inf: none so far) to those of each observer, where its limits include a cell."""
    drop = 0.0 if state.earth is None else state.earth.drop
    for eye, limits in zip(state.observers.eyes, state.observers.limits):
        heights = least_heights_of(scene, eye, drop, threads)
        away = state.sensors.points - eye
        inside = limits.includes(away, np.sqrt((away * away).sum(1)), state.up)
        np.fmin(best, np.where(inside, heights, np.inf), out=best)


def _within(at: np.ndarray, eyes: np.ndarray, distance: float) -> NDArray[np.bool_]:
    """(n,) bool: whether points may be within a distance of any of the eyes, by their bounds."""
    if distance == np.inf:
        return np.ones(len(at), bool)
    lower, upper = eyes.min(0) - distance, eyes.max(0) + distance
    return np.asarray(((at >= lower) & (at <= upper)).all(1))


def _add(state: _ViewshedState, places: np.ndarray, some: np.ndarray, words: np.ndarray) -> None:
    """Record what some observers (indices) see of some sensors (indices); words: bits of all their pairs."""
    visible = unpack_bits(words, len(some))
    for k, observer in enumerate(some.tolist()):
        _add_seen(state, places[visible[:, k]], observer)


def _add_seen(state: _ViewshedState, at: np.ndarray, observer: int) -> None:
    """Record that an observer has a free line of sight to some sensors (indices); its limits may exclude some."""
    sight = state.sight
    away = state.sensors.points[at] - state.observers.eyes[observer]
    distance = np.sqrt((away * away).sum(1))
    inside = state.observers.limits[observer].includes(away, distance, state.up)
    at, distance = at[inside], distance[inside]
    sight.observers[at] += 1
    sight.first[at] = np.minimum(sight.first[at], np.int32(observer))
    nearest = sight.distance[at]
    nearer = (distance < nearest) | ((distance == nearest) & (observer < sight.nearest[at]))
    sight.distance[at[nearer]], sight.nearest[at[nearer]] = distance[nearer], observer
    if sight.length is not None and state.lengths is not None:
        sight.length[at] += state.lengths[observer]
    if sight.bits is not None:
        sight.bits[at, observer // 64] |= np.uint64(1 << observer % 64)
