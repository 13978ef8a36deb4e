"""Viewsheds: how many observers see each sensor of a scene, and which."""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from ...checks import as_array, flag, number, points
from ...engine.plan import DEFAULT_PLAN, Plan, parse_plan
from ...engine.scene import AnyScene
from ...engine.scene_loading import SceneLike, scene_of
from ...errors import InputError
from ...kernels.parallel import thread_count
from ...progress import Progress, report_progress, with_progress
from ...query.query_bounds import morton_codes
from ...scene.lights import MAX_SPP
from ..readsensors import sensors_of
from ..sensors import Sensors, on_top, point_sensors
from ..table import Column, Table
from .bitrows import unpacked, words_of
from .earth import EARTH_RADIUS, REFRACTION, CurvedScene, earth_of
from .ends import ends_of, sensors_from
from .limits import Limits, checked_limits
from .tiles import Tracing

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
class _Asked:
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
    asked = sensors_from(scene, named, None, "sensors")
    limits = checked_limits(min_distance, max_distance, azimuth, elevation)
    eyes = _eyes(scene, observers, eye_height, on_surface, time, threads)
    n, k = len(asked), len(eyes)
    if bits and 8 * n * words_of(k) > _MOST:
        raise InputError(
            f"bits of {n} sensors and {k} observers take {n * k / 8e9:.1f} GB; visibility_matrix streams them"
        )
    kept = np.zeros((n, words_of(k)), np.uint64) if bits else None
    none = np.full(n, -1, np.int32)
    sight = _Sight(np.zeros(n, np.int32), np.full(n, k, np.int32), none, np.full(n, np.inf), kept)
    work = _Asked(asked, eyes, limits, scene.up, sight)
    with report_progress(f"{n} sensors, {k} observers") as heard:
        if curvature:
            _curved(work, CurvedScene(scene, earth, time), plan, threads, heard)
        else:
            _straight(work, scene, Tracing(scene, plan, time, threads, n * k), heard)
    about = {"job": "viewshed", "observers": k, "eye_height": eye_height, **limits._asdict()}
    about["max_distance"] = None if limits.max_distance == np.inf else limits.max_distance
    if curvature:
        about |= {"refraction": refraction, "earth_radius": earth_radius}
    return Viewshed(Table(asked, _columns(sight, k), about, scene, marks=eyes), eyes, kept)


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
    seen = sight.seen > 0
    return {
        "seen": Column(sight.seen, "", f"observers that see it, of {observers}"),
        "first": Column(np.where(seen, sight.first, -1).astype(np.int32), "", "first observer that sees it"),
        "nearest": Column(sight.nearest, "", "nearest observer that sees it"),
        "distance": Column(np.where(seen, sight.distance, np.nan), "m", "distance to the nearest observer"),
    }


def _straight(asked: _Asked, scene: AnyScene, tracing: Tracing, progress) -> None:
    """All observers, in lists; sensors beyond the reach of a list are not asked."""
    ends, eyes = ends_of(scene, asked.sensors), ends_of(scene, point_sensors(asked.eyes))
    curve, order = (np.argsort(morton_codes(each.origins[0]), kind="stable") for each in (ends, eyes))
    for first in range(0, len(order), MAX_SPP):
        some = order[first : first + MAX_SPP]
        places = curve[_within(asked.sensors.points[curve], asked.eyes[some], asked.limits.max_distance)]
        step = max(1024, _PAIRS // len(some))
        for start in range(0, len(places), step):
            part = places[start : start + step]
            _add(asked, part, some, tracing.visible(ends.take(part), eyes.take(some)))
            progress(first + len(some) * min(start + step, len(places)) // len(places), len(order))


def _within(at: np.ndarray, eyes: np.ndarray, distance: float) -> np.ndarray:
    """(n,) bool: can points be so near one of the eyes?"""
    low, high = eyes.min(0) - distance, eyes.max(0) + distance
    return ((at >= low) & (at <= high)).all(1)


def _curved(asked: _Asked, curved: CurvedScene, plan, threads, progress) -> None:
    """One observer after the other, each in a copy of the scene."""
    for k, eye in enumerate(asked.eyes):
        places = np.flatnonzero(_within(asked.sensors.points, eye[None], asked.limits.max_distance))
        if len(places):
            copy, sensors = curved.seen_from(eye), curved.sensors(asked.sensors, eye)
            ends = ends_of(copy, sensors).take(places)
            tracing = Tracing(copy, plan, 0.0, threads, len(places))
            one = ends_of(copy, point_sensors(eye[None]))
            _add(asked, places, np.array([k]), tracing.visible(ends, one))
        progress(k + 1, len(asked.eyes))


def _add(asked: _Asked, places: np.ndarray, some: np.ndarray, words: np.ndarray) -> None:
    """Note what some observers (numbers) see of some sensors (numbers); words: bits of all their pairs."""
    found, visible = asked.found, unpacked(words, len(some))
    rows, columns = np.nonzero(visible)
    away = asked.sensors.points[places[rows]] - asked.eyes[some[columns]]
    distance = np.sqrt((away * away).sum(1))
    kept = asked.limits.inside(away, distance, asked.up)
    rows, columns, distance = rows[kept], columns[kept], distance[kept]
    at, who = places[rows], some[columns]
    np.add.at(found.seen, at, 1)
    np.minimum.at(found.first, at, who.astype(np.int32))
    order = np.lexsort((who, distance, at))
    at, begin = np.unique(at[order], return_index=True)
    nearest, distance = who[order][begin], distance[order][begin]
    nearer = (distance < found.distance[at]) | ((distance == found.distance[at]) & (nearest < found.nearest[at]))
    found.distance[at[nearer]], found.nearest[at[nearer]] = distance[nearer], nearest[nearer]
    if found.bits is not None:
        _set_bits(found.bits, places[rows], who)


def _set_bits(bits: np.ndarray, rows: np.ndarray, columns: np.ndarray) -> None:
    np.bitwise_or.at(bits, (rows, columns // 64), np.uint64(1) << (columns % 64).astype(np.uint64))
