"""`viewshed`: how many observers see each sensor, and which; with distance and angle limits, and earth curvature.

Earth curvature and refraction follow GIS programs: a point at horizontal distance d sinks by (1 - k) d^2 / (2 R). A
straight line over this lowered copy of the scene represents a refracted line over the earth.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any, NamedTuple, ParamSpec

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ...base.checks import as_array, points
from ...base.errors import InputError
from ...base.option_fields import Given, with_keywords
from ...base.progress import Progress, report_progress, with_progress
from ...engine.measured_scenes import earth_radius_of, measured_scene
from ...engine.scene import AnyScene, Scene
from ...engine.scene_loading import SceneLike
from ...kernels.parallel import thread_count
from ...query.query_bounds import morton_codes
from ...scene.lights import MAX_SPP
from ...scene.map_point import on_earth
from ...work.result_summary import Summary
from ..sensors.point_checks import notes_on_bare_points, notes_on_points, notes_on_sensors, on_surface, tell
from ..sensors.sensor_files import sensors_of
from ..sensors.sensors import Sensors, corners_of, point_sensors, sensors_from, sightline_ends
from ..tables.bit_matrices import unpack_bits, words_of
from ..tables.result_table import Column, Table
from .least_heights import check_own_cells, least_heights_of
from .line_points import LinePoints
from .viewshed_options import ViewshedOptions
from .visibility_matrix import TileTracer

_P = ParamSpec("_P")

# --- Earth curvature and refraction -----------------------------------------------------------------------------------


_REFRACTION = 0.13  # of the atmosphere of the earth
_SAG = 1e-3  # metres: maximum height of an edge above the curve between its ends


class Earth(NamedTuple):
    """A curved earth.

    drop : float
        (1 - k) / (2 R), per world unit.
    up : int
        The axis that points up.
    sag : float
        Maximum height of an edge above the curve between its ends, world units.
    """

    drop: float
    up: int
    sag: float = _SAG

    @property
    def longest(self) -> float:
        """The longest edge that is not divided; the middle of an edge lies drop * length^2 / 4 above the curve."""
        return float(2.0 * np.sqrt(self.sag / self.drop))

    def lowered(self, points: NDArray[np.float64], observer: NDArray[np.float64]) -> NDArray[np.float64]:
        """(..., 3) float64: points, lowered for an observer."""
        out = points.copy()
        away = np.delete(points - observer, self.up, -1)
        out[..., self.up] -= self.drop * (away * away).sum(-1)
        return out

    def tilted(
        self, normals: NDArray[np.float64], points: NDArray[np.float64], observer: NDArray[np.float64]
    ) -> NDArray[np.float64]:
        """(n, 3) float64: the normals of lowered surfaces, of any length."""
        away = points - observer
        away[:, self.up] = 0.0
        return np.asarray(normals + 2.0 * self.drop * normals[:, self.up, None] * away)


class CurvedScene:
    """A scene on a curved earth, as observers see it. Long edges are divided identically in both adjacent faces."""

    def __init__(self, scene: AnyScene, earth: Earth, time: float):
        self.scene, self.earth, self.corners = scene, earth, subdivide(corners_of(scene, time), earth.longest)

    def scene_for(self, observer: NDArray[np.float64]) -> Scene:
        """The lowered copy for an observer ((3,) world)."""
        return Scene.from_arrays(self.earth.lowered(self.corners, observer), name=self.scene.name, up=self.scene.up)

    def sensors(self, sensors: Sensors, observer: NDArray[np.float64]) -> Sensors:
        """The sensors of the copy. Those on faces are lifted by the maximum height of a face above the curve."""
        at, normals = self.earth.lowered(sensors.points, observer), sensors.normals
        if normals is not None:
            normals = self.earth.tilted(normals, sensors.points, observer)
            normals /= np.linalg.norm(normals, axis=1, keepdims=True)
            if sensors.faces is not None:
                at[sensors.faces >= 0] += (self.earth.sag * normals)[sensors.faces >= 0]
        return replace(sensors, points=at, normals=normals)


def subdivide(corners: NDArray[np.float64], longest: float) -> NDArray[np.float64]:
    """(m, 3, 3): triangles with no edge longer than `longest`; longer edges are halved, the longest of a face first.

    Adjacent faces halve a shared edge at the same point, since halving depends only on the edge.
    """
    finished = list[np.ndarray]()
    while len(corners):
        lengths = np.linalg.norm(np.roll(corners, -1, 1) - corners, axis=2)
        k = lengths.argmax(1)
        long = lengths[np.arange(len(k)), k] > longest
        finished.append(corners[~long])
        corners, k = corners[long], k[long]
        row = np.arange(len(k))
        a, b, c = (corners[row, (k + shift) % 3] for shift in range(3))
        middle = (a + b) / 2.0
        corners = np.concatenate([np.stack([a, middle, c], 1), np.stack([middle, b, c], 1)])
    return np.concatenate([np.empty((0, 3, 3)), *finished])


# --- Viewsheds --------------------------------------------------------------------------------------------------------


MAX_PAIRS = 1 << 22  # pairs of sensors and observers unpacked at a time
_MOST = 1 << 31  # maximum bytes of bits


class Viewshed(NamedTuple):
    """What observers see of a scene."""

    table: Table  # one row per sensor: seen, first, nearest, distance
    observers: np.ndarray  # (k, 3) float64, world: the observers' eyes
    bits: np.ndarray | None  # (n, ceil(k / 64)) uint64: bit j of row i: observer j sees sensor i; None: not requested

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
    eyes: np.ndarray  # (k, 3)
    options: ViewshedOptions
    up: str
    sight: _Sight
    lengths: np.ndarray | None  # (k,): of the line around each observer

    @property
    def drop(self) -> float:
        """As in `Earth`; 0 for a flat earth."""
        options = self.options
        assert options.earth_radius is not None and options.refraction is not None
        return (1.0 - options.refraction) / (2.0 * options.earth_radius) if options.curvature else 0.0


@with_keywords(ViewshedOptions, 3)
@with_progress
def viewshed(
    given: Given[_P], scene: SceneLike, sensors: Sensors | str | ArrayLike, observers: ArrayLike | LinePoints,
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
    observers : (3,) or (k, 3) float, or LinePoints
        World coordinates, or the points along lines of `antumbra.points_along`.
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
        a limit or below the surface.

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
    Sightlines are straight and exact. With `curvature`, each observer gets a copy of the scene whose vertices at a
    horizontal distance d are (1 - k) d^2 / (2 R) lower, as in GIS programs; results are exact for this copy's float32
    vertices. Edges are divided until they follow the curve within a millimetre, and sensors on faces are lifted by the
    same amount. Each observer then costs one BVH build.

    Least heights are a closed form of the horizon profile, the maximum over all crossings of the line of sight with
    edges of triangles, in float64. They agree with exact lines of sight up to the float32 rounding of coordinates.
    With `curvature`, vertices are lowered and edges are not divided.
    """
    options, scene = ViewshedOptions(**given(*args, **keywords)), measured_scene(scene)
    options = _with_earth(options, scene)
    threads, time = thread_count(options.threads), scene.clamped(options.time)
    below = scene if surface is None else measured_scene(surface)
    checked = sensors_of(sensors, below, threads) if isinstance(sensors, str) else sensors
    targets = sensors_from(scene, checked, None, "sensors")
    along = observers if isinstance(observers, LinePoints) else None
    eyes = _eyes(below, observers if along is None else along.points, options)
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
    visibility_bits = np.zeros((n, words_of(k)), np.uint64) if options.bits else None
    no_observer = np.full(n, -1, np.int32)
    sight = _Sight(
        np.zeros(n, np.int32), np.full(n, k, np.int32), no_observer, np.full(n, np.inf), visibility_bits,
        None if along is None else np.zeros(n), np.full(n, np.inf) if options.least_height else None,
    )  # fmt: skip
    state = _ViewshedState(targets, eyes, options, scene.up, sight, None if along is None else along.lengths)
    recorded = ["eye_height", "min_distance", "max_distance", "azimuth", "elevation"]
    with report_progress(f"{n} sensors, {k} observers") as report:
        if options.curvature:
            sag = scene.unit.of_metres(_SAG)
            _curved(state, CurvedScene(scene, Earth(state.drop, "xyz".index(scene.up), sag), time), report)
            recorded += ["refraction", "earth_radius"]
        else:
            _straight(state, scene, TileTracer(scene, options.plan, time, threads, n * k), report)
        if sight.least_height is not None:
            _find_least_heights(state, sight.least_height, scene, threads)
    about = {"job": "viewshed", "observers": k, **{name: getattr(options, name) for name in recorded}, **warned}
    columns = _columns(sight, k, scene.unit.name)
    return Viewshed(Table(targets, columns, about, scene, marks=eyes), eyes, visibility_bits)


def _with_earth(options: ViewshedOptions, scene: AnyScene) -> ViewshedOptions:
    """Options with the radius of the body that a scene is on, and the refraction there."""
    radius, refraction = options.earth_radius, options.refraction
    if refraction is None:
        refraction = _REFRACTION if scene.crs is None or on_earth(scene.crs) else 0.0
    return replace(options, earth_radius=radius or earth_radius_of(scene), refraction=refraction)


def _eyes(scene: AnyScene, observers: ArrayLike, options: ViewshedOptions) -> NDArray[np.float64]:
    """(k, 3) float64: the observers' eyes."""
    eyes = points(np.atleast_2d(as_array(observers, "observers")), "observers").copy()
    if not len(eyes):
        raise InputError("there is no observer; give at least one")
    up = "xyz".index(scene.up)
    if options.on_surface:
        eyes = on_surface(scene, eyes, "observers", scene.clamped(options.time), thread_count(options.threads))
    eyes[:, up] += options.eye_height
    return eyes


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


def _straight(
    state: _ViewshedState, scene: AnyScene, tracing: TileTracer, progress: Callable[[int, int], object]
) -> None:
    """Trace all observers in lists, and skip sensors beyond the reach of a list."""
    ends, eyes = sightline_ends(scene, state.sensors), sightline_ends(scene, point_sensors(state.eyes))
    order, curve = np.argsort(morton_codes(eyes.origins[0]), kind="stable"), np.arange(ends.n)
    in_rows = state.sensors.kind == "raster" and tracing.prefers_rows
    if not in_rows:
        curve = np.argsort(morton_codes(ends.origins[0]), kind="stable")
    for first in range(0, len(order), MAX_SPP):
        some = order[first : first + MAX_SPP]
        places = curve
        if state.options.reach < np.inf:
            places = curve[_within(state.sensors.points[curve], state.eyes[some], state.options.reach)]
        step = max(1024, MAX_PAIRS // len(some))
        for start in range(0, len(places), step):
            part = places[start : start + step]
            rows = ends.take(slice(start, start + step) if in_rows and places is curve else part)
            _add(state, part, some, tracing.visible(rows, eyes.take(some)))
            progress(first + len(some) * min(start + step, len(places)) // len(places), len(order))


def _find_least_heights(state: _ViewshedState, best: np.ndarray, scene: AnyScene, threads: int) -> None:
    """Lower the least heights ((n,), inf: none so far) to those of each observer, where its limits include a cell."""
    options = state.options
    for eye in state.eyes:
        heights = least_heights_of(scene, eye, state.drop, threads)
        away = state.sensors.points - eye
        inside = options.includes(away, np.sqrt((away * away).sum(1)), state.up)
        np.fmin(best, np.where(inside, heights, np.inf), out=best)


def _within(at: np.ndarray, eyes: np.ndarray, distance: float) -> NDArray[np.bool_]:
    """(n,) bool: whether points may be within a distance of any of the eyes, by their bounds."""
    if distance == np.inf:
        return np.ones(len(at), bool)
    lower, upper = eyes.min(0) - distance, eyes.max(0) + distance
    return np.asarray(((at >= lower) & (at <= upper)).all(1))


def _curved(state: _ViewshedState, curved: CurvedScene, progress: Callable[[int, int], object]) -> None:
    """Trace one observer at a time, each in its own copy of the scene."""
    options = state.options
    for k, eye in enumerate(state.eyes):
        places = np.flatnonzero(_within(state.sensors.points, eye[None], state.options.reach))
        if len(places):
            copy, sensors = curved.scene_for(eye), curved.sensors(state.sensors, eye)
            ends = sightline_ends(copy, sensors).take(places)
            tracing = TileTracer(copy, options.plan, 0.0, options.threads, len(places))
            one = sightline_ends(copy, point_sensors(eye[None]))
            _add(state, places, np.array([k]), tracing.visible(ends, one))
        progress(k + 1, len(state.eyes))


def _add(state: _ViewshedState, places: np.ndarray, some: np.ndarray, words: np.ndarray) -> None:
    """Record what some observers (indices) see of some sensors (indices); words: bits of all their pairs."""
    sight, visible = state.sight, unpack_bits(words, len(some))
    for k, observer in enumerate(some.tolist()):
        at = places[visible[:, k]]
        away = state.sensors.points[at] - state.eyes[observer]
        distance = np.sqrt((away * away).sum(1))
        inside = state.options.includes(away, distance, state.up)
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
