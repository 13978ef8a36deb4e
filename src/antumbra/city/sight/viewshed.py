"""`viewshed`: how many observers see each sensor, and which; with distance and angle limits, and earth curvature."""

import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields
from functools import cache, partial
from typing import TYPE_CHECKING, Any, NamedTuple, ParamSpec, cast

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ...base.errors import InputError
from ...base.extras import import_extra
from ...base.option_fields import Given, with_keywords
from ...base.progress import Progress, with_progress
from ...base.wording import counted
from ...engine.measured_scenes import measured_scene
from ...engine.scene import AnyScene
from ...engine.scene_loading import SceneLike
from ...kernels.parallel import thread_count
from ...query.query_bounds import morton_codes
from ...query.receivers import Receivers
from ...scene.lights import MAX_SPP
from ...trace.terrain.terrain_views import SEEN, UNDECIDED, Over
from ...work.executors import Keep, checked_keep, executor_of
from ...work.result_summary import Summary
from ...work.scene_records import scene_digest
from ...work.work_parts import about_parts, inexact_plan
from ..sensors.block_parts import BlockParts, warned_by_block
from ..sensors.curved_earth import Earth, curvature_record, earth_of, lowered_scene
from ..sensors.point_checks import notes_on_bare_points, notes_on_points, notes_on_sensors, tell
from ..sensors.sensor_blocks import DescribedSensors, SensorBlocks
from ..sensors.sensor_files import sensor_blocks
from ..sensors.sensors import Sensors, point_sensors, sensors_from, sightline_ends
from ..sheets.method_facts import unit_of
from ..tables.bit_matrices import unpack_bits, words_of
from ..tables.partitions import Partitions
from ..tables.polygon_files import check_polygon_output, level_crs, outlines, write_polygons
from ..tables.result_table import Column, Table
from ..tables.table_blocks import TableBlocks
from .least_heights import check_own_cells, least_heights_of
from .line_points import LinePoints
from .observers import Observers, observers_of
from .viewshed_options import ViewshedOptions
from .visibility_matrix import TileTracer

if TYPE_CHECKING:
    import geopandas

_P = ParamSpec("_P")


# --- Viewsheds --------------------------------------------------------------------------------------------------------


SENSORS_PER_PART = 1 << 18
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
        seen, unit = self.table.totals["seen"], unit_of(self.table.about)
        n = seen.rows
        values: dict[str, Any] = {"scene": scene, "sensors": n, "observers": len(self.observers)}
        values |= {"seen": seen.positive, "seconds": seconds}
        share = 100.0 * values["seen"] / max(n, 1)
        lines = [("sensors", f"{n:,}"), ("observers", f"{len(self.observers):,}")]
        lines.append(("seen by any", f"{values['seen']:,} ({share:.1f} %)"))
        if seen.area > 0.0:
            square = unit.square_metres
            values |= {"area": seen.area * square, "area_seen": seen.area_positive * square}
            lines.append(("area seen", f"{values['area_seen']:,.6g} of {values['area']:,.6g} m2"))
        return Summary(values, lines)


def seen_polygons(found: Viewshed) -> Any:
    """`Viewshed.polygons`."""
    geopandas = import_extra("geopandas", "polygons", "gis")
    table = found.table.whole()
    raster = table.sensors.raster
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
    surface: "SceneLike | None" = None, keep: Keep = None, progress: Progress = None, *args: _P.args,
    **keywords: _P.kwargs,
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
    keep : str, path-like or executor, optional
        Folder for the finished parts of an interrupted study, or an executor for the parts; see
        `antumbra.work.executors`.
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
        a limit or below the surface. With `each`, a column ``seen_NAME`` for each observer. None if the executor leaves
        parts to other shards.

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

    Examples
    --------
    >>> wall = at.Scene.from_arrays([[-9, 5, 0], [9, 5, 0], [9, 5, 3], [-9, 5, 3]], [[0, 1, 2], [0, 2, 3]], up="z")
    >>> seen = at.viewshed(wall, [[0, 9, 1], [0, 2, 1], [12, 6, 1]], observers=[[0, 0, 2], [0, 12, 2]])
    >>> seen.table["seen"]
    array([1, 1, 2], dtype=int32)
    """
    options = ViewshedOptions(**given(*args, **keywords))
    found = viewshed_blocks(scene, options, sensors, observers, surface, keep)
    if found is None:
        return None  # type: ignore[return-value]  # a shard, of a command
    table = found.table.whole()
    found.table.close()
    return found._replace(table=table)


def viewshed_blocks(
    scene: SceneLike, options: ViewshedOptions, sensors: SensorBlocks | str | ArrayLike,
    observers: ArrayLike | Sensors | LinePoints, surface: "SceneLike | None", keep: Keep, partitioned: bool = False,
) -> Viewshed | None:  # fmt: skip
    """`viewshed`, whose table is made by block if the sensors are described. Its `close` removes the finished parts.

    partitioned : as for `sun_blocks`
    """
    keep, scene = checked_keep(keep), measured_scene(scene)
    earth = earth_of(options, scene)
    threads, time = thread_count(options.threads), scene.clamped(options.time)
    below = scene if surface is None else measured_scene(surface)
    named = sensor_blocks(sensors, below, threads) if isinstance(sensors, str) else sensors
    described = None
    if isinstance(named, DescribedSensors) and (options.bits or options.least_height):
        named = named.whole()
    elif isinstance(named, DescribedSensors):
        described = named
    given_targets = point_sensors(np.empty((0, 3)))
    if described is None:
        given_targets = sensors_from(scene, cast(Any, named), None, "sensors")
    targets: SensorBlocks = described or given_targets
    along = observers if isinstance(observers, LinePoints) else None
    seers = observers_of(below, observers if along is None else along.points, options)
    eyes, executor = seers.eyes, executor_of(keep)
    notes = notes_on_sensors(below, given_targets, "sensors", time, threads)
    notes += notes_on_points(below, eyes, "observers", time, threads)
    notes += notes_on_bare_points(below, eyes, "observers", time, threads)
    warned = tell(notes)
    n, k = len(targets), len(eyes)
    if options.least_height:
        check_own_cells(scene, given_targets)
    if options.bits and 8 * n * words_of(k) > _MOST:
        raise InputError(
            f"bits of {counted(n, 'sensor')} and {counted(k, 'observer')} take {n * k / 8e9:.1f} GB; "
            "visibility_matrix streams them"
        )
    if options.each and n * k > _MOST and not described:
        raise InputError(
            f"columns of {counted(n, 'sensor')} and {counted(k, 'observer')} take {n * k / 1e9:.1f} GB; "
            "use bits instead of each"
        )
    tracing = cache(lambda: _tracing(scene, earth, options, n * k))
    lengths = None if along is None else along.lengths

    def sums(some: Sensors) -> dict[str, np.ndarray]:
        state = _ViewshedState(some, seers, scene.up, _no_sight(len(some), k, options, lengths), lengths, earth)
        _trace(state, *tracing())
        if state.sight.least_height is not None:
            _find_least_heights(state, state.sight.least_height, scene, threads)
        return {name: values for name, values in state.sight._asdict().items() if values is not None}

    size = max(n, 1) if options.least_height else SENSORS_PER_PART
    about = None
    if executor.folder is not None:
        settings, *limits = map(_settings, (options, *seers.limits))
        of = [*targets.description, eyes, limits, *([] if lengths is None else [lengths])]
        plan, curved = inexact_plan(options.plan), list(curvature_record(options, scene).values())
        about = about_parts("viewshed", scene_digest(scene, time, threads), plan, settings, curved, *of)
    noted = partial(notes_on_sensors, below, what="sensors", time=time, threads=threads) if described else None
    what = f"{counted(n, 'sensor')}, {counted(k, 'observer')}"
    blocks = BlockParts(what, targets, size, sums, executor.folder, about, noted)
    recorded = ["eye_height", "min_distance", "max_distance", "azimuth", "elevation"]
    of_study = {"job": "viewshed", "observers": k, **{name: getattr(options, name) for name in recorded}}
    of_study |= curvature_record(options, scene)

    def table_of(some: Sensors, found: Mapping[str, np.ndarray]) -> Table:
        arrays: dict[str, Any] = {name: found.get(name) for name in _Sight._fields}
        sight = _Sight(**arrays)
        columns = _columns(sight, k, scene.unit.name)
        if options.each and sight.bits is not None:
            columns |= _columns_of_each(sight.bits, seers.names)
        return Table(some, columns, dict(of_study), scene, marks=eyes)

    parts, partitions = blocks.parts, None
    block_of = lambda some, k: table_of(some, parts[k])
    if described is not None and partitioned and executor.folder is not None and n:
        columns_of = [of_study, options.each, list(seers.names)]
        partitions = Partitions(blocks, [], block_of, described, scene, columns_of)
    if not executor.finish([blocks.parts]):
        return None
    of_study |= warned_by_block(notes, blocks) if described else warned
    close = partial(executor.end, [blocks.parts])
    if described is not None:
        made = lambda some, columns: Table(some, columns, dict(of_study), scene, marks=eyes)
        whole = lambda some: table_of(some, blocks.whole())
        table: Any = (
            TableBlocks(described, parts.ranges, block_of, whole, close)
            if partitions is None
            else TableBlocks.of_partitions(partitions, made, close)
        )
        return Viewshed(table, eyes, None, seers.names)
    found = blocks.whole()
    close()
    bits = found["bits"] if options.bits else None
    return Viewshed(table_of(given_targets, found), eyes, bits, seers.names)


def _settings(options: ViewshedOptions) -> dict[str, Any]:
    """The options on which results depend."""
    return {each.name: getattr(options, each.name) for each in fields(options) if each.name not in ("plan", "threads")}


def _no_sight(n: int, k: int, options: ViewshedOptions, lengths: np.ndarray | None) -> _Sight:
    """That of n sensors which none of k observers sees."""
    bits = np.zeros((n, words_of(k)), np.uint64) if options.bits or options.each else None
    length, least = None if lengths is None else np.zeros(n), np.full(n, np.inf) if options.least_height else None
    none, first = np.full(n, -1, np.int32), np.full(n, k, np.int32)
    return _Sight(np.zeros(n, np.int32), first, none, np.full(n, np.inf), bits, length, least)


def _tracing(
    scene: AnyScene, earth: Earth | None, options: ViewshedOptions, sightlines: int
) -> tuple[AnyScene, TileTracer]:
    """The scene in which lines of sight are straight, and its tracer."""
    time, threads = scene.clamped(options.time), thread_count(options.threads)
    if earth is None:
        return scene, TileTracer(scene, options.plan, time, threads, sightlines)
    copy = lowered_scene(scene, earth, time)
    return copy, TileTracer(copy, options.plan, 0.0, threads, sightlines)


def _columns_of_each(bits: np.ndarray, names: Sequence[str]) -> dict[str, Column]:
    """Whether each observer sees each sensor."""
    return {
        f"seen_{name}": Column(unpack_bits(bits[:, j // 64 : j // 64 + 1], 64)[:, j % 64], "", "seen by it")
        for j, name in enumerate(names)
    }


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


def _trace(state: _ViewshedState, scene: AnyScene, tracing: TileTracer) -> None:
    """Trace all observers in lists, and skip sensors beyond the reach of a list; scene: lowered on a curved earth."""
    observers = state.observers
    sensors, at = state.sensors, point_sensors(observers.eyes)
    if state.earth is not None:
        sensors, at = state.earth.lowered_sensors(sensors), state.earth.lowered_sensors(at)
    ends, eyes = sightline_ends(scene, sensors), sightline_ends(scene, at)
    order, curve = np.argsort(morton_codes(eyes.origins[0]), kind="stable"), np.arange(ends.n)
    over = tracing.over(ends, state.sensors.cells)
    if over is not None:
        order = np.array([k for k in order.tolist() if not _add_view(state, (ends, over), eyes, k, tracing)], np.int64)
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


def _add_view(
    state: _ViewshedState, targets: tuple[Receivers, Over], eyes: Receivers, observer: int, tracing: TileTracer
) -> bool:
    """Record what an observer sees of the cells of a raster of heights, by one sweep; whether that was possible."""
    (ends, over), alone = targets, np.array([observer])
    classes = tracing.view(over, state.sensors.cells, eyes.origins[0, observer], state.observers.reach(alone))
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
