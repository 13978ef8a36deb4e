"""Measure surface points: trace all receivers in blocks of sixteen neighbours, and evaluate their occlusion bits.

Each receiver of a block has its own sample set, and neighbours share packets. Blocks of scattered receivers follow a
space-filling curve; a block of a texture is 4 x 4 texels.
"""

from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray

from ..engine.plan import Plan
from ..engine.scene import AnyScene, Scene
from ..engine.small_scenes import UP, small_scene
from ..picture.irradiance import pixel_normals
from ..picture.light_visibility import irradiance_shares, unoccluded_directions
from ..picture.shading import arriving_irradiance
from ..query.equal_samples import traced_samples
from ..query.gbuffer import GBuffer
from ..query.light_samples import light_samples
from ..query.query_bounds import morton_codes
from ..query.receivers import NOTHING, Receivers
from ..query.shadow_query import ShadowQuery
from ..scene.lights import Light, PointLight
from ..trace.transmission import TracedQuery, lit_fraction, occluded_count
from ..work.scene_records import light_record, scene_digest
from ..work.work_parts import Parts, about_parts, inexact_plan
from .bounces import Bounces

SIDE = 4  # receivers along the side of a block
BLOCK = SIDE * SIDE
BLOCKS_PER_PART = 1 << 12  # blocks per part, traced by one query


class ReceiverPoints(NamedTuple):
    """Points on surfaces."""

    positions: np.ndarray  # (n, 3) float64, world
    normals: np.ndarray  # (n, 3) float64, unit

    def at(self, index: NDArray[Any] | slice) -> "ReceiverPoints":
        return ReceiverPoints(self.positions[index], self.normals[index])


class MeterSettings(NamedTuple):
    """The quantity that a bake measures, and its settings."""

    what: str  # a key of `bake_options.QUANTITIES`
    lights: list[Light]
    spp: int
    sampler: str
    plan: str | Plan | None
    time: float
    threads: int | None
    seed: int = 0
    bounces: int = 0  # of light
    separate: bool = False  # whether skies and bounced light have channels of their own, after those of other lights

    @property
    def colours(self) -> int:
        return 3 if self.what in ("light", "bent-normal") else 1

    @property
    def channels(self) -> int:
        return 2 * self.colours if self.separate else self.colours

    def samples(self) -> list[NDArray[np.float64]]:
        return [light_samples(light, self.spp, self.sampler, self.seed) for light in self.lights]


def curve_blocks(positions: NDArray[np.float64]) -> NDArray[np.int64]:
    """(m, 16) int64: receivers in blocks along a space-filling curve; -1 pads the last block."""
    order = (
        np.argsort(morton_codes(positions - positions.mean(0)), kind="stable") if len(positions) else np.empty(0, int)
    )
    places = np.full(-(-len(order) // BLOCK) * BLOCK, -1)
    places[: len(order)] = order
    return places.reshape(-1, BLOCK)


def curve_order(blocks: NDArray[np.int64], positions: NDArray[np.float64]) -> NDArray[np.int64]:
    """The (m, 16) blocks, sorted along a space-filling curve by their first receivers."""
    first = blocks[np.arange(len(blocks)), (blocks >= 0).argmax(1)]
    return np.asarray(blocks[np.argsort(morton_codes(positions[first] - positions.mean(0)), kind="stable")])


Shadows: TypeAlias = list[TracedQuery]
"""The query and the answer of each light."""


_SMOOTH = "hemisphere", "list"
"""Domains of lights that vary slowly over a surface: the whole sky, or many lights in it."""


class Meter:
    """Measures receivers of one scene, for which one tree is built.

    Parameters
    ----------
    scene : Scene or PagedScene
    settings : MeterSettings
    receivers : int
        Approximate number of receivers to come.
    emission : (n, 3) float32, optional
        Radiance of each face of the scene, which counts with `MeterSettings.bounces`.
    """

    def __init__(
        self,
        scene: AnyScene,
        settings: MeterSettings,
        receivers: int,
        emission: NDArray[np.float32] | None = None,
    ):
        self.scene, self.settings, self._samples, self.rays = scene, settings, settings.samples(), 0
        self._engine = scene.engine.with_options(settings.plan, settings.threads, None)
        self._bounces, self.emission = None, emission
        self._rays_each = sum(map(traced_samples, settings.lights, self._samples))
        if settings.bounces:
            _, lights, spp, sampler, *_ = settings
            self._bounces = Bounces(
                self._engine, settings.bounces, lights, spp, sampler, emission, settings.time, settings.seed
            )
            self._rays_each += self._bounces.rays_each
        self._later = receivers * self._rays_each

    def values(self, receivers: ReceiverPoints) -> NDArray[np.float32]:
        """(n, c) float32: the values of a few receivers, traced by one query."""
        out = np.zeros((len(receivers.positions), self.settings.channels), np.float32)
        grid = _grid(curve_blocks(receivers.positions))
        there = grid >= 0
        out[grid[there]] = self.measured(receivers, grid, there)[there]
        return out

    def measured(
        self, receivers: ReceiverPoints, grid: NDArray[np.int64], there: NDArray[np.bool_]
    ) -> NDArray[np.float32]:
        """(h, w, c) float32: the quantity at the receivers of a grid; `there`: which of its cells have one."""
        ends = self.ends(receivers, grid, there)
        lights = self.settings.lights
        shadows = self.shadows(ends, lights, self._samples)
        if self._bounces is None:
            indirect: float | NDArray[np.float32] = 0.0
        else:
            direct = lambda met, tested, samples: self.evaluate(tested, self.shadows(met, tested, samples))
            indirect = self._bounces.irradiance(ends, direct)
        if not self.settings.separate:
            return self.evaluate(lights, shadows) + indirect
        parts = np.zeros((2, *there.shape, self.settings.colours), np.float32)
        parts[1] += indirect
        for light, traced in zip(lights, shadows):
            parts[int(light.domain in _SMOOTH)] += self.evaluate([light], [traced])
        return np.concatenate(list(parts), -1)

    def counts(self, receivers: ReceiverPoints, grid: NDArray[np.int64], there: NDArray[np.bool_]) -> NDArray[np.int32]:
        """(h, w, lights) int32: the number of occluded samples of each light, instead of the quantity."""
        shadows = self.shadows(self.ends(receivers, grid, there), self.settings.lights, self._samples)
        return np.stack([occluded_count(traced) for traced in shadows], -1)

    def ends(self, receivers: ReceiverPoints, grid: NDArray[np.int64], there: NDArray[np.bool_]) -> Receivers:
        """The receivers of a grid, off their surfaces; their rays are counted."""
        world, normals = receivers.positions[grid], receivers.normals[grid]
        ends = Receivers.moved_off(world, normals, self.scene.origin, middle=self.scene.middle)
        self.rays += int(there.sum()) * self._rays_each
        return ends._replace(sides=np.where(there, 1, NOTHING).astype(np.int8))

    def shadows(self, ends: Receivers, lights: Sequence[Light], samples: Sequence[NDArray[np.float64]]) -> Shadows:
        """Trace the shadow rays of receivers to lights."""
        return self._engine.shadows(ends, lights, samples, time=self.settings.time, later=self._later)

    def evaluate(self, lights: Sequence[Light], shadows: Shadows) -> NDArray[np.float32]:
        """(h, w, c) float32: the quantity, from the occlusion bits of each light."""
        what, threads = self.settings.what, self.settings.threads
        if what in ("ao", "shadow"):
            return np.asarray(self._shares(shadows).mean(-1, keepdims=True, dtype=np.float32))
        if what == "bent-normal":
            (traced,) = shadows
            return _directions(unoccluded_directions(traced, threads), traced.query.normals)
        total = np.zeros((*shadows[0].query.sides.shape, self.settings.colours), np.float32)
        for light, traced in zip(lights, shadows):
            tint = 1.0 if what == "sun" else np.float32(light.intensity) * np.asarray(light.colour, np.float32)
            total += self._irradiance(light, traced, tint)
        return total

    def _irradiance(self, light: Light, traced: TracedQuery, tint: float | NDArray[np.float32]) -> NDArray[np.float32]:
        """(h, w, 1 or 3) float32: the irradiance from a light with its shadows; ambient light is a uniform sky."""
        threads, surfaces = self.settings.threads, _surfaces(traced.query, self.scene.origin)
        if light.domain == "list":  # the list has its own intensities and colours
            return arriving_irradiance(surfaces, light, traced, threads=threads)
        share = irradiance_shares(pixel_normals(surfaces, None), traced, threads)
        share = share[..., None] if share.ndim == 2 else share
        if light.domain != "hemisphere":
            share = share * arriving_irradiance(surfaces, light, traced, threads=threads)[..., None]
        return self._in_channels(share * tint)

    def _shares(self, shadows: Shadows) -> NDArray[np.float32]:
        return np.stack([lit_fraction(traced, self.settings.threads) for traced in shadows], -1)

    def _in_channels(self, light: NDArray[np.float32]) -> NDArray[np.float32]:
        """Light of 1 or 3 channels, with the channels of the quantity."""
        return light.mean(-1, keepdims=True) if light.shape[-1] > self.settings.colours else np.asarray(light)


class Measurement:
    """A measurement of many receivers, in parts.

    meter : Meter
    receivers : ReceiverPoints
    blocks : (m, 16) int64
        From `curve_blocks`, or blocks of texels.
    counted : bool
        Count the occluded samples of each light instead of evaluating the quantity.
    folder : Path or None
        Stores the parts; None: in memory.
    """

    def __init__(self, meter: Meter, receivers: ReceiverPoints, blocks: np.ndarray, counted: bool, folder: Path | None):
        self.receivers, self.blocks = receivers, blocks
        self._meter, self._counted = meter, counted
        settings, about = meter.settings, None
        if folder is not None:
            lights, plan = [light_record(light) for light in settings.lights], inexact_plan(settings.plan)
            scene = scene_digest(meter.scene, meter.scene.clamped(settings.time), settings.threads)
            quantity = settings.what, lights, settings.spp, settings.sampler, settings.seed, plan, counted
            bounced = () if not settings.bounces else (settings.bounces, settings.separate, meter.emission)
            about = about_parts("bake", scene, *quantity, *receivers, blocks, *bounced)
        size = BLOCKS_PER_PART // (4 if settings.bounces else 1)  # paths take long: report and store them more often
        self.parts = Parts("tracing rays", len(blocks), size, self._part, folder, about)

    def _part(self, first: int, last: int) -> dict[str, np.ndarray]:
        grid = _grid(self.blocks[first:last])
        there, meter = grid >= 0, self._meter
        found = meter.counts if self._counted else meter.measured
        return {"found": found(self.receivers, grid, there)[there]}

    def result(self) -> np.ndarray:
        """(n, c) float32 values or (n, lights) int32 counts, once all parts are done; 0 for receivers in no block."""
        kind, settings = (np.int32 if self._counted else np.float32), self._meter.settings
        width = len(settings.lights) if self._counted else settings.channels
        out = np.zeros((len(self.receivers.positions), width), kind)
        for k, (first, last) in enumerate(self.parts.ranges):
            grid = _grid(self.blocks[first:last])
            out[grid[grid >= 0]] = self.parts[k]["found"]
        return out


def _grid(blocks: NDArray[np.int64]) -> NDArray[np.int64]:
    """(4, 4 m): the receivers of m blocks as a picture four rows high, so that each block uses all sample sets."""
    return blocks.reshape(-1, SIDE, SIDE).transpose(1, 0, 2).reshape(SIDE, -1)


def _surfaces(query: ShadowQuery, origin: np.ndarray) -> GBuffer:
    """The receivers of a query as a G-buffer."""
    zero = np.zeros(query.sides.shape, np.float32)
    return GBuffer(query.origins, query.normals.astype(np.float32), query.ids, zero, query.sides, origin)


def _directions(sums: np.ndarray, normals: np.ndarray) -> NDArray[np.float32]:
    """Sums of directions, normalized; the normal where all directions are occluded."""
    length = np.linalg.norm(sums, axis=-1, keepdims=True)
    return np.where(length > 1e-6, sums / np.maximum(length, 1e-6), normals).astype(np.float32)


def _example() -> None:
    scene = Scene.of_data(small_scene())
    for what in ("light", "bent-normal"):
        light, sampler = PointLight((0.0, 2.0, 0.0)), "larcher-pillichshammer"
        settings = MeterSettings(what, [light], 1, sampler, "bsah+single", 0.0, 1)
        Meter(scene, settings, 1).values(ReceiverPoints(np.zeros((1, 3)), UP))


EXAMPLES = {"points": _example}
"""The example calls of bakes."""
