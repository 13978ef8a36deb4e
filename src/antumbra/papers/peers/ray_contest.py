"""Times contenders that answer the same rays, in turns in one process, and compares their answers.

The rays are those of our shadow and primary queries, in orders that suit the peers.
"""

import statistics
import time
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from ...query.gbuffer import from_hits
from ...query.light_samples import light_samples
from ...query.rasteriser import rasterise
from ...query.receivers import NOTHING
from ...query.shadow_query import ShadowQuery, segments, shadow_queries
from ...scene.camera import Camera, CameraRays
from ...scene.lights import Light
from ...scene.triangles import Triangles

# --- Ray sets for peers: the rays of our queries, in orders that suit the peers ---------------------------------------


BLOCK = 4  # pixels along each side of a block; its 16 pixels make a packet
LANES = BLOCK * BLOCK
ORDERS = ("pixels", "samples")
"""The packets: one light sample of 4 x 4 pixels (8 lanes: 4 x 2, 4 lanes: 4 x 1), or 16 (8, 4) samples of one pixel."""


class PeerRays(NamedTuple):
    """Rays of an (h, w) picture, spp for each pixel. The id of ray s of pixel (y, x) is (y * w + x) * spp + s."""

    shape: tuple[int, int, int]  # (h, w, spp)
    origins: np.ndarray  # (m, 3) float32; ray i starts at origins[i // each]
    each: int  # rays of each origin
    directions: np.ndarray  # (h * w * spp, 3) float32, of any length; t is in units of this length
    tmax: float  # tmin is 0
    asked: np.ndarray  # (h * w * spp,) bool: the rays that peers get


def shadow_rays(query: ShadowQuery) -> PeerRays:
    """The segments of a query, receiver to light sample, over (0, 1).

    The rays asked are those that our tracers trace. So peers do not trace samples below their receiver's horizon, or
    rays of pixels that see nothing. Directions are rounded to float32; ours are the exact difference of the two ends.
    """
    ends, above = segments(query)
    ends -= query.origins[:, :, None]
    asked = above & (query.sides != NOTHING)[..., None]
    return PeerRays(above.shape, query.origins.reshape(-1, 3), above.shape[2], ends.reshape(-1, 3), 1.0, asked.ravel())


def primary_rays(rays: CameraRays) -> PeerRays:
    """The rays through the centres of a camera's pixels, over (0, inf), with the bits of `pixels.pixel_direction`."""
    y, x = np.mgrid[: rays.height, : rays.width][..., None]
    directions = ((rays.corner + (x + 0.5) * rays.dx) + (y + 0.5) * rays.dy).astype(np.float32).reshape(-1, 3)
    shape, asked = (rays.height, rays.width, 1), np.ones(len(directions), bool)
    return PeerRays(shape, rays.origin.reshape(1, 3), len(directions), directions, np.inf, asked)


def ray_set(origins, directions, tmax=np.inf) -> PeerRays:
    """Any rays, (n, 3) each, as a picture of one row."""
    origins, directions = (np.ascontiguousarray(a, np.float32) for a in (origins, directions))
    return PeerRays((1, len(origins), 1), origins, 1, directions, float(tmax), np.ones(len(origins), bool))


def blocks(h: int, w: int) -> np.ndarray:
    """(n, 16) int64: pixels y * w + x of blocks of 4 x 4, with the blocks in Morton order; -1: not in the picture."""
    rows, columns = -(-h // BLOCK), -(-w // BLOCK)
    y, x = np.mgrid[:rows, :columns].reshape(2, -1)
    code = sum(((x >> k) & 1) << (2 * k) | ((y >> k) & 1) << (2 * k + 1) for k in range(16))
    order = np.argsort(code, kind="stable")
    lane = np.arange(LANES)
    y, x = y[order, None] * BLOCK + lane // BLOCK, x[order, None] * BLOCK + lane % BLOCK
    return np.where((y < h) & (x < w), y * w + x, -1)


def packets(rays: PeerRays, order: str, lanes: int = LANES) -> np.ndarray:
    """(n, lanes) int32: ray ids of packets in one of ORDERS; -1 in a lane without a ray. No packet is empty.

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
    ids[~rays.asked[ids] | (ids < 0)] = -1
    ids = ids.reshape(-1, lanes)
    return ids[(ids >= 0).any(1)].astype(np.int32)


def one_by_one(ids: np.ndarray) -> np.ndarray:
    """(n,) int32: the ray ids of packets, in order, without the empty lanes."""
    return ids[ids >= 0]


def gathered(rays: PeerRays, ids: np.ndarray) -> np.ndarray:
    """(n, 6) float32: origins and directions of the rays with these ids, (n,)."""
    return np.concatenate([rays.origins[ids // rays.each], rays.directions[ids]], 1)


# --- The shadow query of a camera and a light -------------------------------------------------------------------------


def query_of(triangles: Triangles, camera: Camera, light: Light, spp: int, threads: int) -> ShadowQuery:
    """The shadow query of the surfaces that a camera sees, with `spp` rays a pixel."""
    rays = camera.rays(triangles.origin)
    hits = rasterise(triangles.vertices.reshape(-1, 9), rays, threads)
    gbuffer = from_hits(*hits, triangles, rays, threads)
    return shadow_queries(triangles, gbuffer, [light], [light_samples(light, spp)], threads=threads)[0]


# --- Times contenders that answer the same rays, in turns in one process, and compares their answers ------------------


OURS = "antumbra"
CLOCKS = {"wall": time.perf_counter, "cpu": time.process_time}
"""Clocks to time with. On one thread, "cpu" does not count the time of other processes on a busy machine."""

_CLOSE, _MOST = 1.25, 2  # modes of a family in the rounds: largest time relative to its best mode, largest number


class Contender(NamedTuple):
    """A method that answers rays. Contenders of one peer's family are its modes; only the best modes count."""

    family: str
    name: str
    ready: Callable[[], Any]  # makes the argument of `run`, anew each time; not timed
    run: Callable[[Any], Any]  # answers the rays; timed
    answer: Callable[[Any], np.ndarray]  # result of `run` -> one number for each ray


class ContestResult(NamedTuple):
    """The result of one contender."""

    contender: Contender
    tried: float  # seconds of the first try, in which our kernels are compiled or loaded
    seconds: list[float]  # seconds of the rounds; empty if other modes of its family were faster
    differs: int  # rays whose answer differs from the first contender's

    def rate(self, n: int, take=statistics.median) -> float:
        """Million rays a second of n rays."""
        return n / take(self.seconds or [self.tried]) / 1e6


def contest(contenders: list[Contender], asked: np.ndarray, rounds: int, clock: str, say: Callable[[str], None]):
    """Try all contenders once, then time ours and the best modes of each family, in turns, for `rounds` rounds.

    asked : (rays,) bool; answers are compared where it is True
    say : shows the current operation

    Returns a list of Result, and the first contender's answers to the rays asked.
    """
    tried, differs, reference = [], [], None
    for contender in contenders:
        say(contender.name)
        seconds, result = _timed(contender, CLOCKS[clock])
        answer = contender.answer(result)[asked]
        reference = answer if reference is None else reference
        tried.append(seconds)
        differs.append(int(np.count_nonzero(answer != reference)))
        del result
    rest = _finalists(contenders, tried)
    seconds = {i: [] for i in rest}
    for turn in range(rounds):
        say(f"round {turn + 1} of {rounds}")
        for i in rest:
            seconds[i].append(_timed(contenders[i], CLOCKS[clock])[0])
    return [ContestResult(c, tried[i], seconds.get(i, []), differs[i]) for i, c in enumerate(contenders)], reference


def _timed(contender: Contender, clock) -> tuple[float, Any]:
    state = contender.ready()
    start = clock()
    result = contender.run(state)
    return clock() - start, result


def _finalists(contenders, tried) -> list[int]:
    """Indices of all our contenders, and of the fastest modes of each peer."""
    chosen = {i for i, c in enumerate(contenders) if c.family == OURS}
    for family in {c.family for c in contenders} - {OURS}:
        modes = sorted((tried[i], i) for i, c in enumerate(contenders) if c.family == family)
        chosen |= {i for seconds, i in modes[:_MOST] if seconds <= _CLOSE * modes[0][0]}
    return sorted(chosen)


def rows(case: dict, results: list[ContestResult], n: int) -> list[dict]:
    """A row for each contender. `ratio`, in our rows, is relative to the fastest peer."""
    peers = [r.rate(n) for r in results if r.contender.family != OURS and r.seconds]
    found = []
    for r in results:
        row = {**case, "family": r.contender.family, "contender": r.contender.name, "rays": n}
        row |= {"mrays": r.rate(n), "best_mrays": r.rate(n, min), "rounds": len(r.seconds), "seconds": r.seconds}
        row |= {"differs": r.differs, "tried_seconds": r.tried}
        if r.contender.family == OURS and peers:
            row["ratio"] = r.rate(n) / max(peers)
        found.append(row)
    return found


def summary(found: list[dict]) -> list[str]:
    """Lines with the geometric mean and the worst of the ratios over all cases, for each of our contenders."""
    ratios: dict[tuple, list[tuple[float, str]]] = {}
    for row in found:
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
