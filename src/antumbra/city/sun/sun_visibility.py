"""The suns that each sensor sees.

Sensors are traced by block. The sensors of a block and the suns are ordered so that a tile of 16 sensors and 16 suns is
a thin ray bundle, in which packet and frusta tracers share work.
"""

from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ...base.wording import counted
from ...engine.plan import Plan
from ...engine.precompilation import precompile
from ...engine.scene import AnyScene
from ...kernels.elementary import acos, cos, sin, tan
from ...kernels.small_matrices import dot
from ...query.light_samples import light_samples
from ...query.query_bounds import morton_codes
from ...query.receivers import Receivers
from ...scene.alpha_masks import channels_of
from ...scene.light_lists import DirectionalLights
from ...scene.lights import MAX_SPP, tangents
from ...scene.materials import MONTHS
from ...sun.sun_positions import Suns
from ...trace.transmission import TracedQuery
from ...work.executors import Keep, executor_of
from ...work.scene_records import scene_digest
from ...work.work_parts import about_parts, inexact_plan
from ..sensors.block_parts import BlockParts
from ..sensors.curved_earth import Earth
from ..sensors.sensor_blocks import DescribedSensors, SensorBlocks
from ..sensors.sensors import Sensors
from ..tables.bit_matrices import RowFile, hidden_sun_rows
from .sun_tally import WHOLE, Calendar, SunLight, Tally, tally_of

# --- Orders of sensors and suns ---------------------------------------------------------------------------------------


BUNDLE = 16  # suns or sensors per tile

_FACINGS = 4.0  # quantization steps of a normal's coordinates, by which sensors are grouped


def direction_order(directions: NDArray[np.float64]) -> NDArray[np.int64]:
    """(k,) int64: an order of directions in which each group of 16 lies close together.

    A k-d tree halves them along their widest axis, at multiples of 16. The shafts of multi-frusta tracing took a
    sixtieth of the time that they take in chronological order, and 0.7 of that along a Morton curve.
    """
    groups, stack = list[np.ndarray](), [np.arange(len(directions))]
    while stack:
        group = stack.pop()
        if len(group) <= BUNDLE:
            groups.append(group)
            continue
        axis = int(np.argmax(np.ptp(directions[group], axis=0)))
        group = group[np.argsort(directions[group, axis], kind="stable")]
        half = -(-len(group) // BUNDLE) // 2 * BUNDLE
        stack += [group[half:], group[:half]]
    return np.concatenate(groups) if groups else np.empty(0, np.int64)


def bundle_order(directions: NDArray[np.float64], seasons: NDArray[np.int64]) -> NDArray[np.int64]:
    """(m,) int64: `direction_order` within each season; all but the last are padded to whole bundles.

    seasons : (k,) int64, of each direction. A bundle is traced through the leaves of one season.
    """
    groups = [np.flatnonzero(seasons == season) for season in np.unique(seasons)]
    groups = [group[direction_order(directions[group])] for group in groups]
    padded = [np.pad(group, (0, -len(group) % BUNDLE), mode="edge") for group in groups[:-1]]
    return np.concatenate([*padded, *groups[-1:], np.empty(0, np.int64)])


def sensor_order(points: NDArray[np.float64], normals: NDArray[np.float64] | None) -> NDArray[np.int64]:
    """(n,) int64: an order of sensors in which neighbours lie close together and face the same way."""
    codes = morton_codes(points - points.mean(0) if len(points) else points)
    if normals is None:
        return np.argsort(codes, kind="stable")
    facing = np.round(normals * _FACINGS).astype(np.int64) @ np.array([1 << 16, 1 << 8, 1])
    return np.lexsort((codes, facing))


# --- Queries ----------------------------------------------------------------------------------------------------------


DISK = 0.533
"""Mean angular diameter of the sun, degrees."""

SENSORS_PER_PART = 1 << 14
ROWS_PER_PART = 1 << 18  # sensors, if they are in rows
NO_DATE = -1
"""Month of directions that belong to the whole year."""

_BEHIND = 1e-3  # cosine below which a sun is certainly behind a surface, despite rounding


class SunQuery(NamedTuple):
    """Sensors of a scene and the suns to test."""

    scene: AnyScene
    sensors: SensorBlocks
    calendar: Calendar
    columns: int  # bins of the calendar
    towards: np.ndarray  # (m, 3) float64: directions to all samples of the suns, in bundle order
    seasons: np.ndarray  # (ceil(m / 16),) int64: the month of each bundle's transmittances; NO_DATE: their mean
    plan: str | Plan | None
    threads: int | None
    earth: Earth | None = None  # on which the scene is lowered, and so are the sensors; None: it is flat


def disk_directions(directions: NDArray[np.float64], samples: int) -> NDArray[np.float64]:
    """(k, samples, 3) float64: unit vectors to points spread over the sun's disk; to its centre if `samples` is 1."""
    if samples == 1:
        return directions[:, None]
    i = np.arange(samples)
    radius = np.sqrt((i + 0.5) / samples) * tan(np.radians(DISK / 2.0))
    angle = i * np.pi * (3.0 - np.sqrt(5.0))  # Vogel's spiral: equal areas
    u, v = (np.array(axes) for axes in zip(*(tangents(d) for d in directions))) if len(directions) else directions
    across = radius[:, None] * (cos(angle)[:, None] * u[:, None] + sin(angle)[:, None] * v[:, None])
    towards = directions[:, None] + across
    return np.asarray(towards / np.linalg.norm(towards, axis=-1, keepdims=True))


def sun_query(
    scene: AnyScene, sensors: SensorBlocks, suns: Suns, bins: np.ndarray, columns: int, *, months: ArrayLike = NO_DATE,
    samples: int = 1, energy: np.ndarray | None = None, plan: str | Plan | None = None, threads: int | None = None,
) -> SunQuery:  # fmt: skip
    """Order the suns in bundles for a query.

    bins : (k, b) int: columns to which the hours of each sun are added
    months : () or (k,) int: the month of each sun, 0 to 11, for transmittances; or `NO_DATE`
    samples : points on the sun's disk
    energy : (k,) float, Wh/m2 perpendicular to the rays; None: zeros
    """
    towards = disk_directions(suns.directions, samples).reshape(-1, 3)
    seasons = np.repeat(seasons_of(scene, np.broadcast_to(months, len(suns.hours))), samples)
    order = bundle_order(towards, seasons)
    places = np.empty(len(towards), np.int32)
    places[order] = np.arange(len(order), dtype=np.int32)  # a direction that pads a bundle has any of its places
    calendar = Calendar(
        places.reshape(-1, samples),
        np.ascontiguousarray(suns.hours, np.float64),
        np.ascontiguousarray(bins, np.int32),
        _starts(suns),
        np.zeros(len(suns.hours)) if energy is None else np.ascontiguousarray(energy, np.float64),
        np.ascontiguousarray(suns.directions, np.float64),
    )
    seasons = seasons[order[::BUNDLE]]
    return SunQuery(scene, sensors, calendar, columns, towards[order], seasons, plan, threads)


def seasons_of(scene: AnyScene, months: np.ndarray) -> NDArray[np.int64]:
    """(k,) int64: for each month, the first one in which the scene lets the same light pass; `NO_DATE` stays."""
    seasons = np.zeros(len(MONTHS), np.int64) if scene.cutouts is None else scene.cutouts.seasons
    out: NDArray[np.int64] = np.append(seasons, NO_DATE)[months]
    return out


def _starts(suns: Suns) -> np.ndarray:
    """(k,) bool: suns that begin a stretch, after a night or a gap in time."""
    seconds, half = suns.times.astype("datetime64[s]").astype(np.int64), 1800.0 * suns.hours
    begins = np.ones(len(seconds), bool)
    begins[1:] = np.diff(seconds) > half[1:] + half[:-1] + 1.0
    return begins


_ORDER = "sensors in their own order"  # the layout of the parts, which their digest covers
_BITS = "bits"  # array of a part that has no sums: (n, ceil(m / 8)) uint8, `SunLight.bits` of m directions
_SUMS_BYTES = 40  # of a sensor, besides those of the bins


class SunSums:
    """The sums of all sensors, computed by block.

    what : name of the work, for users
    folder : stores the parts; None: in memory
    matrix : whether the parts also contain the bits of each sensor and sun
    notes : as for `BlockParts`
    """

    def __init__(
        self, query: SunQuery, what: str, folder: Path | None = None, matrix: bool = False,
        notes: Callable[[Sensors], Sequence[str]] | None = None,
    ):  # fmt: skip
        precompile("sun hours")
        self._query, self._matrix, n = query, matrix, len(query.sensors)
        self._rows = n > 0 and _in_rows(query)
        self._has_bits = self._rows and not matrix and _bits_are_less(query)
        about = None
        if folder is not None:
            settings: tuple[Any, ...] = (
                inexact_plan(query.plan),
                query.columns,
                matrix,
                notes is not None,
                f"{_ORDER}, {_BITS}" if self._has_bits else _ORDER,
                query.seasons,
            )
            of, earth = scene_digest(query.scene, 0.0, query.threads), query.earth
            settings += (None if earth is None else [earth.drop, earth.centre.tolist(), earth.sag],)
            about = about_parts(what, of, *settings, *query.calendar, *query.sensors.description)
        title = f"{what}: {counted(n, 'sensor')} x {counted(len(query.calendar.hours), 'direction')}"
        size = ROWS_PER_PART if self._rows else SENSORS_PER_PART
        self.blocks = BlockParts(title, query.sensors, size, self._sums_of_block, folder, about, notes)
        self.parts = self.blocks.parts

    def _sums_of_block(self, sensors: Sensors) -> dict[str, np.ndarray]:
        """The sums of a block, whose sensors are traced in an order in which neighbours lie close together."""
        query = self._query
        sensors = sensors if query.earth is None else query.earth.lowered_sensors(sensors)
        points, normals = sensors.points, sensors.normals
        order = np.arange(len(sensors)) if self._rows else sensor_order(points, normals)
        at_once = max(1, _PASSING_BYTES // (4 * len(query.towards) + 1)) if _transmits(query.scene) else len(order)
        places = np.split(order, range(at_once, len(order), at_once)) if len(order) else [order]
        receivers = Receivers.of(points, normals, query.scene.origin, query.scene.middle)
        parts = [self._sums(receivers.take(some), None if normals is None else normals[some]) for some in places]
        back = np.argsort(order)
        return {name: np.concatenate([part[name] for part in parts])[back] for name in parts[0]}

    def _sums(self, receivers: Receivers, normals: NDArray[np.float64] | None) -> dict[str, np.ndarray]:
        """The sums of some sensors."""
        query = self._query
        light = _light_of(query, receivers, normals)
        if self._has_bits:
            return {_BITS: np.ascontiguousarray(light.bits.view(np.uint8)[:, : -(-len(query.towards) // 8)])}
        sums = tally_of(light, normals, query.calendar, query.columns, query.threads)._asdict()
        return {**sums, "matrix": hidden_sun_rows(light.bits, query.calendar.places)} if self._matrix else sums

    def tally(self) -> Tally:
        """The sums of each sensor, once all parts are done; only once for parts in memory."""
        if not len(self.parts):
            nothing = SunLight(np.empty((0, 1), np.uint64), WHOLE)
            return tally_of(nothing, None, self._query.calendar, self._query.columns)
        if self._has_bits:
            return self._tally_of_bits(self.parts.taken([_BITS])[_BITS])
        return Tally(**self.parts.taken(Tally._fields))

    def tally_of_part(self, k: int) -> Tally:
        """The sums of a block, which must be done."""
        part = self.parts[k]
        if self._has_bits:
            return self._tally_of_bits(part[_BITS])
        return Tally(**{name: part[name] for name in Tally._fields})

    def _tally_of_bits(self, rows: NDArray[np.uint8]) -> Tally:
        """The sums of cells of a raster, which face up, from their `_BITS`."""
        query, n = self._query, len(rows)
        bits = np.zeros((n, 8 * -(-rows.shape[1] // 8)), np.uint8)
        bits[:, : rows.shape[1]] = rows
        up = np.eye(3)["xyz".index(query.scene.up)]
        light = SunLight(bits.view(np.uint64), WHOLE)
        return tally_of(light, np.broadcast_to(up, (n, 3)), query.calendar, query.columns, query.threads)

    @property
    def matrix_shape(self) -> tuple[int, int]:
        """Rows, at most, and words per row of the matrix."""
        return len(self._query.sensors), -(-len(self._query.calendar.hours) // 64)

    def write_matrix(self, path: Path) -> None:
        """Write the bits of each sensor and sun, once all parts are done; see `hidden_sun_rows`."""
        counts = self.blocks.counts()
        with RowFile(path, (sum(counts), self.matrix_shape[1])) as file:
            for k, first in enumerate(np.cumsum([0, *counts[:-1]]).tolist() if counts else ()):
                file.put(np.arange(first, first + counts[k]), self.parts[k]["matrix"])


def _bits_are_less(query: SunQuery) -> bool:
    """Whether the bits of described cells, which face up, take less room than their sums, which follow from them."""
    if query.earth is not None or _transmits(query.scene) or not isinstance(query.sensors, DescribedSensors):
        return False
    return -(-len(query.towards) // 8) <= _SUMS_BYTES + 8 * query.columns


def _in_rows(query: SunQuery) -> bool:
    """Whether the sensors stay in rows, since the engine traces these fastest."""
    if query.sensors.kind != "raster":
        return False
    return query.scene.engine.with_options(query.plan, query.threads, None).prefers_rows


def sum_suns(query: SunQuery, keep: Keep = None, what: str = "suns") -> Tally | None:
    """The sums of all sensors; None if an executor leaves parts to other shards.

    keep : as for `antumbra.sun_hours`
    what : name of the work, for users
    """
    executor = executor_of(keep)
    work = SunSums(query, what, executor.folder)
    if not executor.finish([work.parts]):
        return None
    tally = work.tally()
    executor.end([work.parts])
    return tally


_PASSING_BYTES = 1 << 26  # of `SunLight.passing` at a time


def _transmits(scene: AnyScene) -> bool:
    """Whether some surfaces let a part of the light pass."""
    cutouts = scene.cutouts
    return cutouts is not None and (channels_of(cutouts.depths) > 0 or len(cutouts.months) > 0)


def _light_of(query: SunQuery, receivers: Receivers, normals: NDArray[np.float64] | None) -> SunLight:
    """The light of all directions at some sensors. Suns behind all of them are not traced."""
    n, m = receivers.n, len(query.towards)
    engine, later = query.scene.engine.with_options(query.plan, query.threads, None), len(query.sensors) * m
    bits = np.full((n, -(-m // 64)), ~np.uint64(0))
    passing = np.zeros((n, 64 * bits.shape[1]), np.float32) if _transmits(query.scene) else WHOLE
    for month, batch in _batches(query.seasons, _in_front(query.towards, normals)):
        places = (batch[:, None] * BUNDLE + np.arange(BUNDLE)).ravel()
        places = places[places < m]
        lights = DirectionalLights(-query.towards[places])
        (traced,) = engine.shadows(receivers, [lights], [light_samples(lights, 1)], later=later, month=month)
        occluded = traced.bits[0]
        bits.view(np.uint16)[:, batch] = occluded.view(np.uint16)[:, : len(batch)]  # a bundle is a word of 16 bits
        if passing is not WHOLE:
            passing[:, places] = arriving_shares(traced)
    return SunLight(bits, passing)


def _batches(seasons: np.ndarray, bundles: np.ndarray) -> Iterator[tuple[int | None, np.ndarray]]:
    """Months of transmittances, and bundles of their seasons, with at most `MAX_SPP` suns at a time."""
    for season in np.unique(seasons[bundles]):
        group, step = bundles[seasons[bundles] == season], MAX_SPP // BUNDLE
        for batch in np.split(group, range(step, len(group), step)):
            yield (None if season == NO_DATE else int(season)), batch


def arriving_shares(traced: TracedQuery) -> NDArray[np.float32]:
    """(n, samples) float32: the share of the light of each sample that arrives, a mean over its channels."""
    bits = np.ascontiguousarray(traced.bits[0]).view(np.uint8)
    shares = np.unpackbits(bits, axis=1, count=traced.spp, bitorder="little") == 0
    out: NDArray[np.float32] = shares.astype(np.float32)
    if traced.light is not None:
        there = traced.light.rows[0] >= 0
        out[there] = traced.light.values[traced.light.rows[0, there]].mean(-1)
    return out


def _in_front(towards: np.ndarray, normals: np.ndarray | None) -> np.ndarray:
    """(b,) int64: the bundles with at least one sun that may be above the horizon of some sensor."""
    bundles = np.arange(-(-len(towards) // BUNDLE))
    if normals is None or not len(normals):
        return bundles
    middle = normals.mean(0)
    length = float(np.sqrt(dot(middle, middle)))
    if length < 0.1:
        return bundles
    widest = acos(np.clip((dot(normals, middle / length)).min(), -1.0, 1.0))
    front = dot(towards, middle / length) > cos(min(np.pi / 2.0 + widest, np.pi)) - _BEHIND
    return bundles[np.bitwise_or.reduceat(front, bundles * BUNDLE)]
