"""`viewshed`: how many observers see each sensor, and which; with distance and angle limits, and a curved earth.

Earth curvature and refraction follow GIS programs: a point at horizontal distance d sinks by (1 - k) d^2 / (2 R). A
straight line over the sunken copy of the scene stands for a refracted line over the earth.
"""

from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from ...checks import as_array, flag, listed, number, points
from ...engine.plan import DEFAULT_PLAN, Plan, parse_plan
from ...engine.scene import AnyScene, Scene
from ...engine.scene_loading import SceneLike, scene_of
from ...errors import InputError
from ...kernels.parallel import thread_count
from ...progress import Progress, report_progress, with_progress
from ...query.query_bounds import morton_codes
from ...scene.lights import MAX_SPP
from ..bit_matrices import unpack_bits, words_of
from ..result_table import Column, Table
from ..sensor_files import sensors_of
from ..sensors import Sensors, corners_of, on_top, point_sensors, sensors_from, sightline_ends
from .visibility_matrix import TileTracer

# --- How far and where observers look: distances, compass directions, and angles above the horizon --------------------


class Limits(NamedTuple):
    """The part of space that each observer looks at.

    min_distance, max_distance : float
        World units, in a straight line; both ends count.
    azimuth : (float, float)
        Degrees clockwise from north (+Y if Z is up, else -Z), from the first to the second: (350, 10) is 20 degrees
        wide. (0, 360): all around.
    elevation : (float, float)
        Degrees above the horizontal, lowest and highest.
    """

    min_distance: float = 0.0
    max_distance: float = np.inf
    azimuth: tuple[float, float] = (0.0, 360.0)
    elevation: tuple[float, float] = (-90.0, 90.0)

    @property
    def all_around(self) -> bool:
        """Do the angles leave nothing out?"""
        return abs(self.azimuth[1] - self.azimuth[0]) >= 360.0 and self.elevation == (-90.0, 90.0)

    def near(self, distance: np.ndarray) -> np.ndarray:
        """Are distances within the limits?"""
        return (distance >= self.min_distance) & (distance <= self.max_distance)

    def inside(self, away: np.ndarray, distance: np.ndarray, up: str) -> np.ndarray:
        """(...) bool: are points within the limits? away: (..., 3) from the observer to them."""
        within = self.near(distance)
        if self.all_around:
            return within
        z = away[..., "xyz".index(up)]
        north = away[..., 1] if up == "z" else -away[..., 2]
        level = np.hypot(away[..., 0], north)
        elevation = np.degrees(np.arctan2(z, level))
        within &= (elevation >= self.elevation[0]) & (elevation <= self.elevation[1])
        wide = self.azimuth[1] - self.azimuth[0]
        if abs(wide) < 360.0:
            turned = np.degrees(np.arctan2(away[..., 0], north)) - self.azimuth[0]
            within &= (turned % 360.0 <= wide % 360.0) | (level == 0.0)
        return within


def checked_limits(min_distance, max_distance, azimuth, elevation) -> Limits:
    """The `Limits`; InputError names what is wrong."""
    least = number(min_distance, "min_distance", 0.0, np.inf, "[)")
    most = np.inf if max_distance is None else number(max_distance, "max_distance", 0.0, np.inf, "(]")
    if least >= most:
        raise InputError(f"min_distance is {least:g} and max_distance {most:g}; nothing lies between them")
    around = _angles(azimuth, "azimuth", 360.0)
    low, high = _angles(elevation, "elevation", 90.0)
    if low > high:
        raise InputError(f"elevation is from {low:g} to {high:g}; give the lower angle first")
    return Limits(least, most, around, (low, high))


def _angles(value, what: str, most: float) -> tuple[float, float]:
    first, last = (number(angle, f"{what} (degrees)", -most, most, "[]") for angle in listed(value, what, 2))
    return first, last


# --- A curved earth with refraction: copies of a scene that sink with the square of the distance from an observer -----
#
# A straight line over the copy stands for a line over the earth that bends with the air, as in the viewsheds of GIS
# programs: a point at a horizontal distance d sinks by (1 - k) d^2 / (2 R).


EARTH_RADIUS = 6_371_000.0
REFRACTION = 0.13
_SAG = 1e-3  # world units: how far an edge may lie above the curve between its ends


class Earth(NamedTuple):
    """A curved earth.

    drop : float
        (1 - k) / (2 R), per world unit.
    up : int
        The axis that points up.
    """

    drop: float
    up: int

    @property
    def longest(self) -> float:
        """The longest edge that stays whole: its middle lies drop * length^2 / 4 above the curve."""
        return 2.0 * np.sqrt(_SAG / self.drop)

    def sunk(self, points: np.ndarray, observer: np.ndarray) -> np.ndarray:
        """(..., 3) float64: points, lowered for an observer."""
        out = points.copy()
        away = np.delete(points - observer, self.up, -1)
        out[..., self.up] -= self.drop * (away * away).sum(-1)
        return out

    def tilted(self, normals: np.ndarray, points: np.ndarray, observer: np.ndarray) -> np.ndarray:
        """(n, 3) float64: the normals of lowered surfaces, of any length."""
        away = points - observer
        away[:, self.up] = 0.0
        return normals + 2.0 * self.drop * normals[:, self.up, None] * away


def earth_of(scene: AnyScene, refraction, radius) -> Earth:
    """A checked `Earth`."""
    k = number(refraction, "refraction", -1.0, 1.0)
    return Earth((1.0 - k) / (2.0 * number(radius, "earth_radius", 0.0, np.inf)), "xyz".index(scene.up))


class CurvedScene:
    """A scene on a curved earth, as observers see it. Long edges are divided, for both faces at them alike."""

    def __init__(self, scene: AnyScene, earth: Earth, time: float):
        self.scene, self.earth, self.corners = scene, earth, subdivide(corners_of(scene, time), earth.longest)

    def seen_from(self, observer: np.ndarray) -> Scene:
        """The copy for an observer ((3,) world)."""
        return Scene.from_arrays(self.earth.sunk(self.corners, observer), name=self.scene.name, up=self.scene.up)

    def sensors(self, sensors: Sensors, observer: np.ndarray) -> Sensors:
        """The sensors of the copy. Those on faces are lifted by the most that a face may lie above the curve."""
        at, normals = self.earth.sunk(sensors.points, observer), sensors.normals
        if normals is not None:
            normals = self.earth.tilted(normals, sensors.points, observer)
            normals /= np.linalg.norm(normals, axis=1, keepdims=True)
            if sensors.faces is not None:
                at[sensors.faces >= 0] += (_SAG * normals)[sensors.faces >= 0]
        return replace(sensors, points=at, normals=normals)


def subdivide(corners: np.ndarray, longest: float) -> np.ndarray:
    """(m, 3, 3): triangles without edges longer than `longest`; each longer one is halved, the longest of a face first.

    Faces at an edge halve it at the same point, because halving depends on the edge alone.
    """
    done = []
    while len(corners):
        lengths = np.linalg.norm(np.roll(corners, -1, 1) - corners, axis=2)
        k = lengths.argmax(1)
        long = lengths[np.arange(len(k)), k] > longest
        done.append(corners[~long])
        corners, k = corners[long], k[long]
        row = np.arange(len(k))
        a, b, c = (corners[row, (k + shift) % 3] for shift in range(3))
        middle = (a + b) / 2.0
        corners = np.concatenate([np.stack([a, middle, c], 1), np.stack([middle, b, c], 1)])
    return np.concatenate([np.empty((0, 3, 3)), *done])


# --- Viewsheds: how many observers see each sensor of a scene, and which ----------------------------------------------


_PAIRS = 1 << 22  # pairs of sensors and observers that are unpacked at a time
_MOST = 1 << 31  # bytes of bits


class Viewshed(NamedTuple):
    """What observers see of a scene."""

    table: Table  # a row for each sensor: seen, first, nearest, distance
    observers: np.ndarray  # (k, 3) float64, world: the observers' eyes
    bits: np.ndarray | None  # (n, ceil(k / 64)) uint64: bit j of row i: observer j sees sensor i; None: not asked


class _Sight(NamedTuple):
    """What is known of some sensors."""

    seen: np.ndarray  # (n,) int32: number of observers
    first: np.ndarray  # (n,) int32: the lowest observer, -1: none
    nearest: np.ndarray  # (n,) int32
    distance: np.ndarray  # (n,) float64, inf: none
    bits: np.ndarray | None  # (n, words) uint64


@dataclass
class _ViewshedState:
    """A viewshed in the making."""

    sensors: Sensors
    eyes: np.ndarray  # (k, 3)
    limits: Limits
    up: str
    found: _Sight


@with_progress
def viewshed(
    scene: SceneLike, sensors: Sensors | str | ArrayLike, observers: ArrayLike, *, eye_height: float = 0.0,
    on_surface: bool = False, min_distance: float = 0.0, max_distance: float | None = None,
    azimuth: tuple[float, float] = (0.0, 360.0), elevation: tuple[float, float] = (-90.0, 90.0),
    curvature: bool = False, refraction: float = REFRACTION, earth_radius: float = EARTH_RADIUS, bits: bool = False,
    plan: str | Plan | None = None, time: float = 0.0, threads: int | None = None,
    progress: Progress = None,
) -> Viewshed:  # fmt: skip
    """Find which observers see each sensor: a cumulative viewshed. Every line of sight is exact.

    Parameters
    ----------
    scene : Scene, PagedScene, or anything that `antumbra.load` takes
    sensors : Sensors, str, or (n, 3) float
        Where to ask. A text is as in `antumbra.sensors_of`: ``"raster:2+1.6"`` places targets 1.6 above the highest
        surfaces, as ``at.raster_sensors(scene, 2.0, height=1.6)`` does. Sensors on surfaces, such as
        ``at.face_sensors(scene)``, are seen from their outer side.
    observers : (3,) or (k, 3) float
        World coordinates.
    eye_height : float
        World units that eyes are above the observers.
    on_surface : bool
        Put each observer on the highest surface above or below it first. Those beside the scene stay where they are.
    min_distance, max_distance : float
        World units, in a straight line from eye to sensor. None: no limit.
    azimuth : (float, float)
        Compass directions in degrees, clockwise from north (+Y if Z is up, else -Z): (350, 10) looks north.
    elevation : (float, float)
        Degrees above the horizontal.
    curvature : bool
        Let the earth curve away from each observer. World units must be those of `earth_radius`.
    refraction : float
        Share k of the curvature that the bending of light takes back; 0 for straight light.
    earth_radius : float
        World units.
    bits : bool
        Keep which observer sees which sensor.
    plan, time, threads
        As in `antumbra.visibility`.
    progress : function of (text, done, total), or bool, optional
        Called while the job works. False: nothing is shown. None: terminals and notebooks show a bar after a second.

    Returns
    -------
    Viewshed
        The columns of its `table` are ``seen``, the number of observers; ``first``, the lowest of their indices, and
        ``nearest``, that of the nearest one, -1 where no observer sees the sensor; and ``distance`` to the nearest one,
        NaN where there is none.

    Raises
    ------
    InputError
        If an argument is wrong, there is no observer, or bits would take more than 2 GiB.

    Notes
    -----
    Sightlines are straight and exact. With `curvature`, each observer gets a copy of the scene whose vertices at a
    horizontal distance d are (1 - k) d^2 / (2 R) lower, as in GIS programs; answers are exact on this copy's float32
    vertices. Edges are divided until they follow the curve within a millimetre (0.001 world units), and sensors on
    faces are lifted by as much. Each observer then costs the building of a BVH.
    """
    scene, threads = scene_of(scene), thread_count(threads)
    time, bits = scene.clamped(time), flag(bits, "bits")
    parse_plan(DEFAULT_PLAN if plan is None else plan)
    earth, curvature = earth_of(scene, refraction, earth_radius), flag(curvature, "curvature")
    named = sensors_of(sensors, scene, threads) if isinstance(sensors, str) else sensors
    targets = sensors_from(scene, named, None, "sensors")
    limits = checked_limits(min_distance, max_distance, azimuth, elevation)
    eyes = _eyes(scene, observers, eye_height, on_surface, time, threads)
    n, k = len(targets), len(eyes)
    if bits and 8 * n * words_of(k) > _MOST:
        raise InputError(
            f"bits of {n} sensors and {k} observers take {n * k / 8e9:.1f} GB; visibility_matrix streams them"
        )
    visibility_bits = np.zeros((n, words_of(k)), np.uint64) if bits else None
    none = np.full(n, -1, np.int32)
    sight = _Sight(np.zeros(n, np.int32), np.full(n, k, np.int32), none, np.full(n, np.inf), visibility_bits)
    work = _ViewshedState(targets, eyes, limits, scene.up, sight)
    with report_progress(f"{n} sensors, {k} observers") as report:
        if curvature:
            _curved(work, CurvedScene(scene, earth, time), plan, threads, report)
        else:
            _straight(work, scene, TileTracer(scene, plan, time, threads, n * k), report)
    about = {"job": "viewshed", "observers": k, "eye_height": eye_height, **limits._asdict()}
    about["max_distance"] = None if limits.max_distance == np.inf else limits.max_distance
    if curvature:
        about |= {"refraction": refraction, "earth_radius": earth_radius}
    return Viewshed(Table(targets, _columns(sight, k), about, scene, marks=eyes), eyes, visibility_bits)


def _eyes(scene: AnyScene, observers, height, on_surface: bool, time: float, threads) -> np.ndarray:
    """(k, 3) float64: the observers' eyes."""
    eyes = points(np.atleast_2d(as_array(observers, "observers")), "observers").copy()
    if not len(eyes):
        raise InputError("there is no observer; give at least one")
    up = "xyz".index(scene.up)
    if flag(on_surface, "on_surface"):
        tops, faces = on_top(scene, eyes, time, threads)
        eyes[:, up] = np.where(faces >= 0, tops, eyes[:, up])
    eyes[:, up] += number(height, "eye_height")
    return eyes


def _columns(sight: _Sight, observers: int) -> dict[str, Column]:
    visible = sight.seen > 0
    return {
        "seen": Column(sight.seen, "", f"observers that see it, of {observers}"),
        "first": Column(np.where(visible, sight.first, -1).astype(np.int32), "", "first observer that sees it"),
        "nearest": Column(sight.nearest, "", "nearest observer that sees it"),
        "distance": Column(np.where(visible, sight.distance, np.nan), "m", "distance to the nearest observer"),
    }


def _straight(state: _ViewshedState, scene: AnyScene, tracing: TileTracer, progress) -> None:
    """All observers, in lists; sensors beyond the reach of a list are not asked."""
    ends, eyes = sightline_ends(scene, state.sensors), sightline_ends(scene, point_sensors(state.eyes))
    curve, order = (np.argsort(morton_codes(each.origins[0]), kind="stable") for each in (ends, eyes))
    for first in range(0, len(order), MAX_SPP):
        some = order[first : first + MAX_SPP]
        places = curve[_within(state.sensors.points[curve], state.eyes[some], state.limits.max_distance)]
        step = max(1024, _PAIRS // len(some))
        for start in range(0, len(places), step):
            part = places[start : start + step]
            _add(state, part, some, tracing.visible(ends.take(part), eyes.take(some)))
            progress(first + len(some) * min(start + step, len(places)) // len(places), len(order))


def _within(at: np.ndarray, eyes: np.ndarray, distance: float) -> np.ndarray:
    """(n,) bool: can points be so near one of the eyes?"""
    low, high = eyes.min(0) - distance, eyes.max(0) + distance
    return ((at >= low) & (at <= high)).all(1)


def _curved(state: _ViewshedState, curved: CurvedScene, plan, threads, progress) -> None:
    """One observer after the other, each in a copy of the scene."""
    for k, eye in enumerate(state.eyes):
        places = np.flatnonzero(_within(state.sensors.points, eye[None], state.limits.max_distance))
        if len(places):
            copy, sensors = curved.seen_from(eye), curved.sensors(state.sensors, eye)
            ends = sightline_ends(copy, sensors).take(places)
            tracing = TileTracer(copy, plan, 0.0, threads, len(places))
            one = sightline_ends(copy, point_sensors(eye[None]))
            _add(state, places, np.array([k]), tracing.visible(ends, one))
        progress(k + 1, len(state.eyes))


def _add(state: _ViewshedState, places: np.ndarray, some: np.ndarray, words: np.ndarray) -> None:
    """Note what some observers (numbers) see of some sensors (numbers); words: bits of all their pairs."""
    sight, visible = state.found, unpack_bits(words, len(some))
    rows, columns = np.nonzero(visible)
    away = state.sensors.points[places[rows]] - state.eyes[some[columns]]
    distance = np.sqrt((away * away).sum(1))
    inside = state.limits.inside(away, distance, state.up)
    rows, columns, distance = rows[inside], columns[inside], distance[inside]
    at, who = places[rows], some[columns]
    np.add.at(sight.seen, at, 1)
    np.minimum.at(sight.first, at, who.astype(np.int32))
    order = np.lexsort((who, distance, at))
    at, begin = np.unique(at[order], return_index=True)
    nearest, distance = who[order][begin], distance[order][begin]
    nearer = (distance < sight.distance[at]) | ((distance == sight.distance[at]) & (nearest < sight.nearest[at]))
    sight.distance[at[nearer]], sight.nearest[at[nearer]] = distance[nearer], nearest[nearer]
    if sight.bits is not None:
        _set_bits(sight.bits, places[rows], who)


def _set_bits(bits: np.ndarray, rows: np.ndarray, columns: np.ndarray) -> None:
    np.bitwise_or.at(bits, (rows, columns // 64), np.uint64(1) << (columns % 64).astype(np.uint64))
