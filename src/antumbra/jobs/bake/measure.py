"""What receivers get: the rays of all receivers, in blocks of sixteen neighbours, and the values from their bits.

Each receiver of a block has a sample set of its own, and neighbours share packets. So blocks of scattered receivers
are made along a space-filling curve, and those of texels are 4 x 4 texels.
"""

from collections.abc import Callable
from contextlib import nullcontext
from typing import NamedTuple

import numpy as np

from ...image.gathered import gathered
from ...image.list_irradiance import list_irradiance
from ...kernels.progress import reported
from ...query.gbuffer import GBuffer
from ...query.order import morton_codes
from ...query.receivers import NOTHING, point_receivers
from ...query.sampling import light_samples
from ...query.shadow import ShadowQuery, fraction_lit
from ...rendering.memory import points_memory
from ...rendering.points import PointQueries
from ...rendering.renderer import Renderer
from ...scene.lights import Light
from ...scene.scene import Scene

SIDE = 4  # receivers along the side of a block
BLOCK = SIDE * SIDE
_BATCH = 1 << 14  # blocks that are asked at once

QUANTITIES = {
    "ao": "the share of the sky that is open, weighted by the cosine",
    "shadow": "the share of the lights that is visible",
    "sun": "the share of the sun that is visible, times the cosine",
    "light": "the irradiance of all lights, linear RGB",
    "bent-normal": "the mean open direction",
}
"""Name of what a bake measures -> its meaning."""


class Receivers(NamedTuple):
    """Points on surfaces."""

    positions: np.ndarray  # (n, 3) float64, world
    normals: np.ndarray  # (n, 3) float64, unit

    def at(self, index) -> "Receivers":
        return Receivers(self.positions[index], self.normals[index])


class Asked(NamedTuple):
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

    def __init__(self, scene: Scene, asked: Asked, receivers: int):
        self.scene, self.asked, self._samples, self.rays = scene, asked, asked.samples(), 0
        total = receivers * sum(samples.shape[1] for samples in self._samples)
        self._points = PointQueries(Renderer(scene, asked.plan, asked.threads), total, asked.time)
        self._points.begin(points_memory(0, asked.lights[0], self._samples[0]))

    def values(
        self, receivers: Receivers, blocks: np.ndarray | None = None, what: str | None = "tracing rays"
    ) -> np.ndarray:
        """(n, c) float32: what each receiver gets; 0 where no block has it.

        what : name of the work, for users; None: say nothing
        """
        out = np.zeros((len(receivers.positions), self.asked.channels), np.float32)
        for places, found in self._asked_blocks(receivers, blocks, what, self._values):
            out[places] = found
        return out

    def counts(self, receivers: Receivers, blocks: np.ndarray) -> np.ndarray:
        """(lights, n) int32: the number of each light's samples that are occluded."""
        out = np.zeros((len(self.asked.lights), len(receivers.positions)), np.int32)
        count = lambda queries: np.stack([np.bitwise_count(b).sum(-1, dtype=np.int32) for _, b in queries], -1)
        for places, found in self._asked_blocks(receivers, blocks, "tracing rays", count):
            out[:, places] = found.T
        return out

    def _asked_blocks(self, receivers: Receivers, blocks, what: str | None, use: Callable):
        """Yield (places, result of `use` for the receivers there), batch by batch."""
        blocks = curve_blocks(receivers.positions) if blocks is None else blocks
        with reported(what) if what else nullcontext(lambda done, total: None) as progress:
            for start in range(0, len(blocks), _BATCH):
                progress(start, len(blocks))
                grid = _grid(blocks[start : start + _BATCH])
                there = grid >= 0
                found = use(self._answered(receivers, grid, there))
                yield grid[there], found[there]
            progress(len(blocks), len(blocks))

    def _answered(
        self, receivers: Receivers, grid: np.ndarray, there: np.ndarray
    ) -> list[tuple[ShadowQuery, np.ndarray]]:
        world, normals = receivers.positions[grid], np.ascontiguousarray(receivers.normals[grid])
        flat = world.reshape(-1, 3)
        origins = point_receivers(flat - self._points.triangles.origin, normals.reshape(-1, 3), flat, False)
        origins, sides = origins.reshape(world.shape), np.where(there, 1, NOTHING).astype(np.int8)
        found = []
        for light, samples in zip(self.asked.lights, self._samples):
            query = self._points.query(origins, sides, normals, light, samples)
            found.append((query, self._points.answer(query)))
            self.rays += int(there.sum()) * samples.shape[1]
        return found

    def _values(self, answered: list[tuple[ShadowQuery, np.ndarray]]) -> np.ndarray:
        """(h, w, c) float32, from the bits of each light."""
        what, threads = self.asked.what, self.asked.threads
        if what in ("ao", "shadow"):
            return self._shares(answered).mean(-1, keepdims=True, dtype=np.float32)
        if what == "bent-normal":
            ((query, bits),) = answered
            return _directions(gathered(query, bits, threads)[..., 1:], query.normals)
        total = np.zeros((*answered[0][0].sides.shape, self.asked.channels), np.float32)
        for light, (query, bits) in zip(self.asked.lights, answered):
            if light.domain == "list":
                total += list_irradiance(
                    _surfaces(query, self._points.triangles.origin), light, query.samples, bits, threads
                )
                continue
            sky = light.domain == "hemisphere"
            arrived = (
                fraction_lit(bits, query.samples.shape[1], threads) if sky else gathered(query, bits, threads)[..., 0]
            )
            tint = 1.0 if what == "sun" else np.float32(light.intensity) * np.asarray(light.colour, np.float32)
            total += arrived[..., None] * tint
        return total

    def _shares(self, answered) -> np.ndarray:
        return np.stack([fraction_lit(b, q.samples.shape[1], self.asked.threads) for q, b in answered], -1)


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
