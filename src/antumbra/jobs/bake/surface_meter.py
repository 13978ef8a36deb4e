"""Measure surface points: trace all receivers in blocks of sixteen neighbours, and evaluate their occlusion bits.

Each receiver of a block has its own sample set, and neighbours share packets. Blocks of scattered receivers follow a
space-filling curve; those of texels are 4 x 4 texels.
"""

from pathlib import Path
from typing import NamedTuple

import numpy as np

from ...engine.scene import Scene
from ...picture.irradiance import facing_of
from ...picture.light_visibility import irradiance_shares, open_directions
from ...picture.shading import arriving_irradiance
from ...query.gbuffer import GBuffer
from ...query.light_samples import light_samples
from ...query.query_bounds import morton_codes
from ...query.receivers import NOTHING, Receivers
from ...query.shadow_query import ShadowQuery, fraction_lit
from ...scene.lights import Light
from ..scene_records import light_record, scene_digest
from ..work_parts import Parts, about_parts, inexact_plan

SIDE = 4  # receivers along the side of a block
BLOCK = SIDE * SIDE
_PART = 1 << 12  # blocks of a part, which are asked at once

QUANTITIES = {
    "ao": "the share of the sky that is open, weighted by the cosine",
    "shadow": "the share of the lights that is visible",
    "sun": "the irradiance of the sun over its intensity",
    "light": "the irradiance of all lights, linear RGB",
    "bent-normal": "the mean open direction",
}
"""Name of what a bake measures -> its meaning."""


class SurfacePoints(NamedTuple):
    """Points on surfaces."""

    positions: np.ndarray  # (n, 3) float64, world
    normals: np.ndarray  # (n, 3) float64, unit

    def at(self, index) -> "SurfacePoints":
        return SurfacePoints(self.positions[index], self.normals[index])


class MeterSettings(NamedTuple):
    """What a bake measures, and how."""

    what: str  # a key of QUANTITIES
    lights: list[Light]
    spp: int
    sampler: str
    plan: str | None
    time: float
    threads: int | None

    @property
    def channels(self) -> int:
        return 3 if self.what in ("light", "bent-normal") else 1

    def samples(self) -> list[np.ndarray]:
        return [light_samples(light, self.spp, self.sampler) for light in self.lights]


def curve_blocks(positions: np.ndarray) -> np.ndarray:
    """(m, 16) int64: receivers in blocks along a space-filling curve; -1 fills the last block."""
    order = (
        np.argsort(morton_codes(positions - positions.mean(0)), kind="stable") if len(positions) else np.empty(0, int)
    )
    places = np.full(-(-len(order) // BLOCK) * BLOCK, -1)
    places[: len(order)] = order
    return places.reshape(-1, BLOCK)


def nearby(blocks: np.ndarray, positions: np.ndarray) -> np.ndarray:
    """The (m, 16) blocks along a space-filling curve, each by its first receiver."""
    first = blocks[np.arange(len(blocks)), (blocks >= 0).argmax(1)]
    return blocks[np.argsort(morton_codes(positions[first] - positions.mean(0)), kind="stable")]


class Meter:
    """Measures receivers of one scene; they share one tree.

    Parameters
    ----------
    scene : Scene
    asked : Asked
    receivers : int
        About so many receivers come.
    """

    def __init__(self, scene: Scene, settings: MeterSettings, receivers: int):
        self.scene, self.asked, self._samples, self.rays = scene, settings, settings.samples(), 0
        self._later = receivers * sum(samples.shape[1] for samples in self._samples)
        self._engine = scene.engine.with_options(settings.plan, settings.threads, None)

    def values(self, receivers: SurfacePoints) -> np.ndarray:
        """(n, c) float32: what each of a few receivers gets, at once."""
        out = np.zeros((len(receivers.positions), self.asked.channels), np.float32)
        grid = _grid(curve_blocks(receivers.positions))
        there = grid >= 0
        out[grid[there]] = self.worth(self.answered(receivers, grid, there))[there]
        return out

    def answered(
        self, receivers: SurfacePoints, grid: np.ndarray, there: np.ndarray
    ) -> list[tuple[ShadowQuery, np.ndarray]]:
        """The query and the bits of each light, of the receivers of a grid."""
        world, normals = receivers.positions[grid], receivers.normals[grid]
        asking = Receivers.moved_off(world, normals, self.scene.origin)
        asking = asking._replace(sides=np.where(there, 1, NOTHING).astype(np.int8))
        results = self._engine.shadows(
            asking, self.asked.lights, self._samples, time=self.asked.time, later=self._later
        )  # fmt: skip
        self.rays += int(there.sum()) * sum(samples.shape[1] for samples in self._samples)
        return results

    def worth(self, answered: list[tuple[ShadowQuery, np.ndarray]]) -> np.ndarray:
        """(h, w, c) float32, from the bits of each light."""
        what, threads = self.asked.what, self.asked.threads
        if what in ("ao", "shadow"):
            return self._shares(answered).mean(-1, keepdims=True, dtype=np.float32)
        if what == "bent-normal":
            ((query, bits),) = answered
            return _directions(open_directions(query, bits, threads), query.normals)
        total = np.zeros((*answered[0][0].sides.shape, self.asked.channels), np.float32)
        for light, (query, bits) in zip(self.asked.lights, answered):
            tint = 1.0 if what == "sun" else np.float32(light.intensity) * np.asarray(light.colour, np.float32)
            total += self._arrived(light, query, bits, tint)
        return total

    def _arrived(self, light: Light, query: ShadowQuery, bits: np.ndarray, tint) -> np.ndarray:
        """(h, w, 1 or 3) float32: the irradiance from a light with its shadows; ambient light is a uniform sky."""
        threads, surfaces = self.asked.threads, _surfaces(query, self.scene.origin)
        if light.domain == "list":  # it has intensities and colours of its own
            return arriving_irradiance(surfaces, light, query, bits, threads=threads)
        share = irradiance_shares(facing_of(surfaces, None), query, bits, threads)
        if light.domain != "hemisphere":
            share = share * arriving_irradiance(surfaces, light, query, bits, threads=threads)
        return share[..., None] * tint

    def _shares(self, answered) -> np.ndarray:
        return np.stack([fraction_lit(b, q.samples.shape[1], self.asked.threads) for q, b in answered], -1)


class Measurement:
    """A measurement of many receivers, part by part.

    meter : Meter
    receivers : SurfacePoints
    blocks : (m, 16) int64
        From `curve_blocks`, or blocks of texels.
    counted : bool
        Whether the number of each light's samples that are occluded is measured, instead of values.
    folder : Path or None
        Where parts are kept; None: in memory.
    """

    def __init__(self, meter: Meter, receivers: SurfacePoints, blocks: np.ndarray, counted: bool, folder: Path | None):
        self.receivers, self.blocks = receivers, blocks
        self._meter, self._counted = meter, counted
        asked, about = meter.asked, None
        if folder is not None:
            lights = [light_record(light) for light in asked.lights]
            facts = asked.what, lights, asked.spp, asked.sampler, inexact_plan(asked.plan), counted
            scene = scene_digest(meter.scene, meter.scene.clamped(asked.time), asked.threads)
            about = about_parts("bake", scene, *facts, *receivers, blocks)
        self.parts = Parts("tracing rays", len(blocks), _PART, self._part, folder, about)

    def _part(self, first: int, last: int) -> dict[str, np.ndarray]:
        grid = _grid(self.blocks[first:last])
        there, meter = grid >= 0, self._meter
        answered = meter.answered(self.receivers, grid, there)
        return {"found": (_counts(answered) if self._counted else meter.worth(answered))[there]}

    def result(self) -> np.ndarray:
        """(n, c) float32 values, or (n, lights) int32 counts, when all parts are done; 0 where no block has it."""
        kind, settings = (np.int32 if self._counted else np.float32), self._meter.asked
        width = len(settings.lights) if self._counted else settings.channels
        out = np.zeros((len(self.receivers.positions), width), kind)
        for k, (first, last) in enumerate(self.parts.ranges):
            grid = _grid(self.blocks[first:last])
            out[grid[grid >= 0]] = self.parts[k]["found"]
        return out


def _counts(answered: list[tuple[ShadowQuery, np.ndarray]]) -> np.ndarray:
    """(h, w, lights) int32: the number of each light's samples that are occluded."""
    return np.stack([np.bitwise_count(bits).sum(-1, dtype=np.int32) for _, bits in answered], -1)


def _grid(blocks: np.ndarray) -> np.ndarray:
    """(4, 4 m): the receivers of m blocks as a picture four rows high, so that each block has all sample sets."""
    return blocks.reshape(-1, SIDE, SIDE).transpose(1, 0, 2).reshape(SIDE, -1)


def _surfaces(query: ShadowQuery, origin: np.ndarray) -> GBuffer:
    """The receivers of a query as the surfaces of a picture."""
    zero = np.zeros(query.sides.shape, np.float32)
    return GBuffer(query.origins, query.normals.astype(np.float32), query.ids, zero, query.sides, origin)


def _directions(sums: np.ndarray, normals: np.ndarray) -> np.ndarray:
    """Unit vectors of sums of directions; the normal where nothing is open."""
    length = np.linalg.norm(sums, axis=-1, keepdims=True)
    return np.where(length > 1e-6, sums / np.maximum(length, 1e-6), normals).astype(np.float32)
