"""Times contenders on the same rays, alternating in one process, and compares their answers.

The rays are those of our shadow and primary queries, in orders that suit the peers.
"""

import statistics
import time
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from antumbra.query.gbuffer import from_hits
from antumbra.query.light_samples import light_samples
from antumbra.query.rasteriser import rasterise
from antumbra.query.receivers import NOTHING
from antumbra.query.shadow_query import ShadowQuery, segments, shadow_queries
from antumbra.scene.camera import Camera, CameraRays
from antumbra.scene.lights import Light
from antumbra.scene.triangles import Triangles

# --- Ray sets ---------------------------------------------------------------------------------------------------------


BLOCK = 4  # pixels along each side of a block, whose 16 pixels form a packet
LANES = BLOCK * BLOCK
ORDERS = ("pixels", "samples")
"""A packet has one light sample of 4 x 4 pixels (8 lanes: 4 x 2, 4 lanes: 4 x 1), or 16 (8, 4) samples of one pixel."""


class PeerRays(NamedTuple):
    """Rays of an (h, w) picture, spp per pixel. The id of ray s of pixel (y, x) is (y * w + x) * spp + s."""

    shape: tuple[int, int, int]  # (h, w, spp)
    origins: np.ndarray  # (m, 3) float32; ray i starts at origins[i // each]
    each: int  # rays per origin
    directions: np.ndarray  # (h * w * spp, 3) float32, of any length; t is in units of this length
    tmax: float  # tmin is 0
    active: np.ndarray  # (h * w * spp,) bool: the rays to trace


def shadow_rays(query: ShadowQuery) -> PeerRays:
    """The segments of a query, receiver to light sample, over (0, 1).

    Active rays are those that our tracers trace, so peers skip samples below their receiver's horizon and pixels
    without a surface. Directions are rounded to float32; ours are the exact difference of the two ends.
    """
    ends, above = segments(query)
    ends -= query.origins[:, :, None]
    active = above & (query.sides != NOTHING)[..., None]
    return PeerRays(above.shape, query.origins.reshape(-1, 3), above.shape[2], ends.reshape(-1, 3), 1.0, active.ravel())


def primary_rays(rays: CameraRays) -> PeerRays:
    """The rays through a camera's pixel centres, over (0, inf), with the bits of `gbuffer.pixel_direction`."""
    y, x = np.mgrid[: rays.height, : rays.width][..., None]
    directions = ((rays.corner + (x + 0.5) * rays.dx) + (y + 0.5) * rays.dy).astype(np.float32).reshape(-1, 3)
    shape, active = (rays.height, rays.width, 1), np.ones(len(directions), bool)
    return PeerRays(shape, rays.origin.reshape(1, 3), len(directions), directions, np.inf, active)


def ray_set(origins: ArrayLike, directions: ArrayLike, tmax: float = np.inf) -> PeerRays:
    """Arbitrary rays, (n, 3) origins and directions, as a picture of one row."""
    origins, directions = (np.ascontiguousarray(a, np.float32) for a in (origins, directions))
    return PeerRays((1, len(origins), 1), origins, 1, directions, float(tmax), np.ones(len(origins), bool))


def blocks(h: int, w: int) -> np.ndarray:
    """(n, 16) int64: pixels y * w + x of 4 x 4 blocks in Morton order; -1: outside the picture."""
    rows, columns = -(-h // BLOCK), -(-w // BLOCK)
    y, x = np.mgrid[:rows, :columns].reshape(2, -1)
    code = sum(((x >> k) & 1) << (2 * k) | ((y >> k) & 1) << (2 * k + 1) for k in range(16))
    order = np.argsort(code, kind="stable")
    lane = np.arange(LANES)
    y, x = y[order, None] * BLOCK + lane // BLOCK, x[order, None] * BLOCK + lane % BLOCK
    return np.where((y < h) & (x < w), y * w + x, -1)


def packets(rays: PeerRays, order: str, lanes: int = LANES) -> np.ndarray:
    """(n, lanes) int32: ray ids of nonempty packets in one of ORDERS; -1 in a lane without a ray.

    lanes : 16, 8 or 4
    """
    h, w, spp = rays.shape
    pixels = blocks(h, w)
    if order == "pixels":
        pixel, sample = pixels[:, None, :], np.arange(spp)[:, None]
    else:
        pixel, sample = pixels[:, :, None], np.arange(-(-spp // LANES) * LANES)
    ids = pixel * spp + sample
    ids[(pixel < 0) | (sample >= spp) & np.ones_like(ids, bool)] = -1
    ids[~rays.active[ids] | (ids < 0)] = -1
    ids = ids.reshape(-1, lanes)
    return ids[(ids >= 0).any(1)].astype(np.int32)


def valid_ids(ids: np.ndarray) -> np.ndarray:
    """(n,) int32: the ray ids of packets, in order, without empty lanes."""
    return ids[ids >= 0]


def ray_array(rays: PeerRays, ids: np.ndarray) -> np.ndarray:
    """(n, 6) float32: origins and directions of the rays with these ids, (n,)."""
    return np.concatenate([rays.origins[ids // rays.each], rays.directions[ids]], 1)


# --- The shadow query of a camera and a light -------------------------------------------------------------------------


def query_of(triangles: Triangles, camera: Camera, light: Light, spp: int, threads: int) -> ShadowQuery:
    """The shadow query of the surfaces visible from a camera, with `spp` rays per pixel."""
    rays = camera.rays(triangles.origin)
    hits = rasterise(triangles.vertices.reshape(-1, 9), rays, threads)
    gbuffer = from_hits(*hits, triangles, rays, threads)
    return shadow_queries(triangles, gbuffer, [light], [light_samples(light, spp)], threads=threads)[0]


# --- Contest ----------------------------------------------------------------------------------------------------------


OURS = "antumbra"
CLOCKS = {"wall": time.perf_counter, "cpu": time.process_time}
"""Clocks for timing. On one thread, "cpu" excludes the time of other processes on a busy machine."""

_CLOSE, _MOST = 1.25, 2  # limits on a family's modes in the rounds: time relative to its best mode, and number


class Contender(NamedTuple):
    """A method that traces rays. Contenders of one family are modes of a peer, of which only the best count."""

    family: str
    name: str
    prepare: Callable[[], Any]  # returns a new argument for each `run`; not timed
    run: Callable[[Any], Any]  # traces the rays; timed
    answer: Callable[[Any], np.ndarray]  # result of `run` -> one number per ray


class ContestResult(NamedTuple):
    """The result of one contender."""

    contender: Contender
    first_seconds: float  # first run, which compiles or loads our kernels
    seconds: list[float]  # of the rounds; empty if other modes of its family were faster
    differs: int  # rays whose answer differs from the first contender's

    def rate(self, n: int, take: Callable[[list[float]], float] = statistics.median) -> float:
        """Million rays per second, for n rays."""
        return n / take(self.seconds or [self.first_seconds]) / 1e6


def contest(
    contenders: list[Contender], active: np.ndarray, rounds: int, clock: str, say: Callable[[str], None]
) -> tuple[list[ContestResult], np.ndarray]:
    """Run all contenders once, then time ours and the best modes of each family alternately for `rounds` rounds.

    active : (rays,) bool; answers are compared where it is True
    say : shows the current operation

    Returns the results, and the first contender's answers for the active rays.
    """
    first_seconds, differs, reference = [], [], None
    for contender in contenders:
        say(contender.name)
        seconds, result = _timed(contender, CLOCKS[clock])
        answer = contender.answer(result)[active]
        reference = answer if reference is None else reference
        first_seconds.append(seconds)
        differs.append(int(np.count_nonzero(answer != reference)))
        del result
    finalists = _finalists(contenders, first_seconds)
    laps: dict[int, list[float]] = {i: [] for i in finalists}
    for turn in range(rounds):
        say(f"round {turn + 1} of {rounds}")
        for i in finalists:
            laps[i].append(_timed(contenders[i], CLOCKS[clock])[0])
    assert reference is not None
    results = [ContestResult(c, first_seconds[i], laps.get(i, []), differs[i]) for i, c in enumerate(contenders)]
    return results, reference


def _timed(contender: Contender, clock: Callable[[], float]) -> tuple[float, Any]:
    state = contender.prepare()
    start = clock()
    result = contender.run(state)
    return clock() - start, result


def _finalists(contenders: list[Contender], first_seconds: list[float]) -> list[int]:
    """Indices of all our contenders and of each peer's fastest modes."""
    chosen = {i for i, c in enumerate(contenders) if c.family == OURS}
    for family in {c.family for c in contenders} - {OURS}:
        modes = sorted((first_seconds[i], i) for i, c in enumerate(contenders) if c.family == family)
        chosen |= {i for seconds, i in modes[:_MOST] if seconds <= _CLOSE * modes[0][0]}
    return sorted(chosen)


def rows(case: dict[str, Any], results: list[ContestResult], n: int) -> list[dict[str, Any]]:
    """A row per contender. `ratio`, in our rows, is our rate over that of the fastest peer."""
    peers = [r.rate(n) for r in results if r.contender.family != OURS and r.seconds]
    table = []
    for r in results:
        row = {**case, "family": r.contender.family, "contender": r.contender.name, "rays": n}
        row |= {"mrays": r.rate(n), "best_mrays": r.rate(n, min), "rounds": len(r.seconds), "seconds": r.seconds}
        row |= {"differs": r.differs, "first_seconds": r.first_seconds}
        if r.contender.family == OURS and peers:
            row["ratio"] = r.rate(n) / max(peers)
        table.append(row)
    return table


def summary(table: list[dict[str, Any]]) -> list[str]:
    """A line per contender of ours, with the geometric mean and the minimum of its ratios over all cases."""
    ratios: dict[tuple[str, int], list[tuple[float, str]]] = {}
    for row in table:
        if "ratio" in row:
            case = " ".join(str(row[k]) for k in ("scene", "light") if k in row)
            ratios.setdefault((row["contender"], row["threads"]), []).append((row["ratio"], case))
    lines = []
    for (name, threads), cases in ratios.items():
        worst, where = min(cases)
        mean = statistics.geometric_mean(ratio for ratio, _ in cases)
        lines.append(
            f"{name}, {threads} thread{'s'[: threads > 1]}: {mean:.2f} times the best peer in geometric mean of "
            f"{len(cases)} cases, {worst:.2f} in the worst ({where})"
        )
    return lines
