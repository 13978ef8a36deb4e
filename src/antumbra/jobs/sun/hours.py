"""Sun hours: which suns each sensor sees, and sums over them."""

from pathlib import Path
from typing import NamedTuple

import numpy as np

from ...engine.plan import Plan
from ...engine.precompilation import Job, fixed_job, precompile
from ...engine.scene import AnyScene
from ...query.receivers import Receivers
from ...scene.light_lists import DirectionalLights
from ...scene.lights import MAX_SPP, tangents
from ..engines import Whole
from ..parts import Parts, about_parts, inexact
from ..rowfile import RowFile
from ..scenedigest import scene_digest
from ..sensors import Sensors
from .bundles import BUNDLE, bundled, in_space
from .matrix import matrix_rows
from .positions import Suns
from .tally import Calendar, Tally, tally_of

DISK = 0.533
"""Mean angular diameter of the sun, degrees."""

_PART = 1 << 14  # sensors of a part
_BEHIND = 1e-3  # cosine below which a sun is behind a surface for certain, whatever rounding does


class Asked(NamedTuple):
    """What is asked of the sensors of a scene."""

    scene: AnyScene
    sensors: Sensors
    receivers: Receivers  # the sensors, off their surfaces
    calendar: Calendar
    columns: int  # bins of the calendar
    order: np.ndarray  # (m,) int64: bundled order of the calendar's directions, (k * samples)
    towards: np.ndarray  # (m, 3) float64: directions to all samples of the suns, bundled
    plan: str | Plan | None
    threads: int | None


def disk_directions(directions: np.ndarray, samples: int) -> np.ndarray:
    """(k, samples, 3) float64: unit vectors to points spread over the sun's disk; to its centre if `samples` is 1."""
    if samples == 1:
        return directions[:, None]
    i = np.arange(samples)
    radius = np.sqrt((i + 0.5) / samples) * np.tan(np.radians(DISK / 2.0))
    angle = i * np.pi * (3.0 - np.sqrt(5.0))  # Vogel's spiral: equal areas
    u, v = (np.array(axes) for axes in zip(*(tangents(d) for d in directions))) if len(directions) else directions
    across = radius[:, None] * (np.cos(angle)[:, None] * u[:, None] + np.sin(angle)[:, None] * v[:, None])
    found = directions[:, None] + across
    return found / np.linalg.norm(found, axis=-1, keepdims=True)


def ask(
    scene: AnyScene, sensors: Sensors, suns: Suns, bins: np.ndarray, columns: int, *, samples: int = 1,
    energy: np.ndarray | None = None, plan: str | Plan | None = None, threads: int | None = None,
) -> Asked:  # fmt: skip
    """What is asked, in bundles.

    bins : (k, b) int: columns to which the hours of each sun are added
    samples : points on the sun's disk
    energy : (k,) float, Wh/m2 at right angles to the rays; None: zeros
    """
    towards = disk_directions(suns.directions, samples).reshape(-1, 3)
    order = bundled(towards)
    places = np.empty(len(order), np.int32)
    places[order] = np.arange(len(order), dtype=np.int32)
    calendar = Calendar(
        places.reshape(-1, samples),
        np.ascontiguousarray(suns.hours, np.float64),
        np.ascontiguousarray(bins, np.int32),
        _starts(suns),
        np.zeros(len(suns.hours)) if energy is None else np.ascontiguousarray(energy, np.float64),
        np.ascontiguousarray(suns.directions, np.float64),
    )
    receivers = Receivers.of(sensors.points, sensors.normals, scene.origin)
    return Asked(scene, sensors, receivers, calendar, columns, order, towards[order], plan, threads)


def _starts(suns: Suns) -> np.ndarray:
    """(k,) bool: suns that begin a stretch, because a night or a gap in time lies before them."""
    seconds, half = suns.times.astype("datetime64[s]").astype(np.int64), 1800.0 * suns.hours
    begins = np.ones(len(seconds), bool)
    begins[1:] = np.diff(seconds) > half[1:] + half[:-1] + 1.0
    return begins


class Sums:
    """The sums of all sensors, made part by part.

    what : name of the work, for users
    folder : where parts are kept; None: in memory
    matrix : whether the parts hold the bits of each sensor and sun too
    """

    def __init__(self, asked: Asked, what: str, folder: Path | None = None, matrix: bool = False):
        precompile(tally_job)
        self._asked, self._matrix, sensors = asked, matrix, asked.sensors
        n = len(sensors)
        self._order = in_space(sensors.points, sensors.normals) if n else np.empty(0, np.int64)
        about = None
        if folder is not None:
            shown = [a for a in (sensors.points, sensors.normals, *asked.calendar) if a is not None]
            of = scene_digest(asked.scene, 0.0, asked.threads)
            about = about_parts(what, of, inexact(asked.plan), asked.columns, matrix, *shown)
        title = f"{what}: {n:,} sensors x {len(asked.calendar.hours):,} directions"
        self.parts = Parts(title, n, _PART, self._part, folder, about)

    def _part(self, first: int, last: int) -> dict[str, np.ndarray]:
        asked, some = self._asked, self._order[first:last]
        bits = _bits_of(asked, some)
        normals = None if asked.sensors.normals is None else asked.sensors.normals[some]
        found = tally_of(bits, normals, asked.calendar, asked.columns, asked.threads)._asdict()
        return {**found, "matrix": matrix_rows(bits, asked.calendar.places)} if self._matrix else found

    def tally(self) -> Tally:
        """The sums of each sensor, in the sensors' own order, when all parts are done."""
        if not len(self._order):
            return tally_of(np.empty((0, 1), np.uint64), None, self._asked.calendar, self._asked.columns)
        done = self.parts.joined(Tally._fields)
        return Tally(**{name: values[np.argsort(self._order)] for name, values in done.items()})

    @property
    def matrix_shape(self) -> tuple[int, int]:
        """Rows and words of the matrix."""
        return len(self._order), -(-len(self._asked.calendar.hours) // 64)

    def write_matrix(self, path: Path) -> None:
        """Write the bits of each sensor and sun, when all parts are done: see `matrix.matrix_rows`."""
        with RowFile(path, self.matrix_shape) as file:
            for k, (first, last) in enumerate(self.parts.ranges):
                file.put(self._order[first:last], self.parts[k]["matrix"])


def answer(asked: Asked, kept: Path | None = None, what: str = "suns") -> Tally:
    """Ask all sensors: the sums of each, in the sensors' own order.

    what : name of the work, for users
    kept : folder in which finished parts wait for the next run of an interrupted job; None: they are not kept
    """
    engine, sums = Whole(kept), Sums(asked, what, kept)
    engine.finish([sums.parts])
    tally = sums.tally()
    engine.end([sums.parts])
    return tally


def _bits_of(asked: Asked, which: np.ndarray) -> np.ndarray:
    """(n, w) uint64: the bits of some sensors, in the order of bundles. Suns behind all of them are not traced."""
    sensors, m = asked.sensors, len(asked.towards)
    receivers, engine = asked.receivers.take(which), asked.scene.engine.with_options(asked.plan, asked.threads, None)
    normals = None if sensors.normals is None else sensors.normals[which]
    bits = np.full((len(which), -(-m // 64)), ~np.uint64(0))
    bundles = _in_front(asked.towards, normals)
    for some in np.split(bundles, range(MAX_SPP // BUNDLE, len(bundles), MAX_SPP // BUNDLE)):
        places = (some[:, None] * BUNDLE + np.arange(BUNDLE)).ravel()
        places = places[places < m]
        if not len(places):
            continue
        lights = DirectionalLights(-asked.towards[places])
        found = engine.visibility(receivers, [lights]).bits[:, 0]
        bits.view(np.uint16)[:, some] = found.view(np.uint16)[:, : len(some)]  # a bundle is a word of 16 bits
    return bits


def _in_front(towards: np.ndarray, normals: np.ndarray | None) -> np.ndarray:
    """(b,) int64: the bundles with a sun that may be above the horizon of some sensor."""
    bundles = np.arange(-(-len(towards) // BUNDLE))
    if normals is None or not len(normals):
        return bundles
    middle = normals.mean(0)
    length = np.linalg.norm(middle)
    if length < 0.1:
        return bundles
    widest = np.arccos(np.clip((normals @ (middle / length)).min(), -1.0, 1.0))
    front = towards @ (middle / length) > np.cos(min(np.pi / 2.0 + widest, np.pi)) - _BEHIND
    return bundles[np.bitwise_or.reduceat(front, bundles * BUNDLE)]


def tally_job() -> Job:
    """The job of sums over suns."""

    def work():
        bits, once = np.zeros((2, 1), np.uint64), np.zeros(1)
        calendar = Calendar(
            np.zeros((1, 1), np.int32), once, np.zeros((1, 1), np.int32), np.ones(1, bool), once, np.zeros((1, 3))
        )
        tally_of(bits, None, calendar, 1, 1)

    return fixed_job("sun hours", work)
