"""Scenes made to be slow: how long each plan takes on them, and how many times as long as the best plan.

    python benchmarks/hostile.py [--scenes NAME ...] [--plans PLAN ...] [--triangles N] [--points N] [--limit SECONDS]
                                 [--threads N] [--json FILE]

The triangles have no area, or hardly any; or many of them share a centroid, a plane, an edge or a point; or all of them
lie at the light. Each of these faults is found in files, though seldom as densely. A plan that takes more than 10 times
as long as the best one on a scene is marked.

Times are CPU times of all threads, with the build of the tree. Each scene is traced in a process of its own, which is
killed when a plan exceeds the limit.
"""

import json
import sys
from collections.abc import Callable, Sequence
from itertools import combinations, islice
from multiprocessing import get_context
from multiprocessing.connection import Connection
from time import process_time
from typing import NamedTuple

import numpy as np

import antumbra as at
from antumbra.engine.plan import covering_plans
from antumbra.kernels.parallel import thread_count
from common import arguments, machine

MOST = 10.0
"""Times as long as the best plan that a plan may take on each scene."""

LEAST = 0.02  # seconds below which nothing is compared: a call costs some of them
LIGHT = np.array([0.0, 8.0, 0.0])
_DIRECTIONS = np.array(
    [[1, 0, 0], [0, 1, 0], [0, 0, 1], [1, 1, 0], [1, 0, 1], [0, 1, 1], [1, 1, 1], [1, -1, 1], [2, 1, 0]], float
)


_CORNERS = np.array([[[k, k, k], [k / 2, k, k], [k, k, k / 2]] for k in (-16.0, 16.0)])  # their middle is zero


class Hostile(NamedTuple):
    """A query that is slow for its size. Coordinates are exact in float32, before and after recentring."""

    triangles: np.ndarray  # (n, 3, 3) float64
    points: np.ndarray  # (m, 3) float64: begins of the segments
    lights: Sequence  # their ends


def _ordinary(rng, n: int) -> np.ndarray:
    """Triangles like those of other scenes, between the points and the light, in steps of 2^-8."""
    at_ = rng.uniform((-6, 1, -6), (6, 3, 6), (n, 1, 3)) + rng.normal(size=(n, 3, 3)) * 0.5
    return np.round(at_ * 256) / 256


def _points(rng, m: int) -> np.ndarray:
    """Points on a floor, in rows as jobs have them."""
    side = int(np.ceil(m**0.5))
    x, z = np.meshgrid(np.linspace(-6, 6, side), np.linspace(-6, 6, side))
    return np.round(np.stack([x, np.zeros_like(x), z], -1).reshape(-1, 3)[:m] * 256) / 256


def _asked(rng, bad: np.ndarray, m: int, light=LIGHT) -> Hostile:
    """Bad triangles among 100 ordinary ones, a point light, and a square light around it."""
    lights = [at.PointLight(light), at.QuadLight(light - (0.25, 0, 0.25), (0.5, 0, 0), (0, 0, 0.5))]
    soup = np.concatenate([bad, _ordinary(rng, 100), _CORNERS])
    return Hostile(soup.astype(np.float32).astype(np.float64), _points(rng, m), lights)


def _on_lines(n: int) -> np.ndarray:
    """(n, 3, 3): corners at powers of two along lines through zero."""
    steps = 2.0 ** np.arange(-26, 4)
    triples = np.array(list(islice(combinations(steps, 3), -(-n // len(_DIRECTIONS)))))
    return (triples[:, None, :, None] * _DIRECTIONS[:, None]).reshape(-1, 3, 3)[:n]


def lines(rng, n: int, m: int) -> Hostile:
    """Corners at powers of two along nine lines: no triangle has an area, and their boxes are nested."""
    return _asked(rng, _on_lines(n), m, np.zeros(3) + (0, 4, 0))


def near_lines(rng, n: int, m: int) -> Hostile:
    """The same, with the last bits of all corners changed: every triangle has hardly any area."""
    bad = _on_lines(n)
    return _asked(rng, bad + bad * rng.integers(-2, 3, bad.shape) * 2.0**-20, m, np.zeros(3) + (0, 4, 0))


def junk_at_light(rng, n: int, m: int) -> Hostile:
    """Triangles without area, all through the light."""
    along = rng.integers(-64, 65, (n, 1, 3)) / 64.0
    return _asked(rng, LIGHT + along * rng.integers(-4, 5, (n, 3, 1)), m)


def points_at_light(rng, n: int, m: int) -> Hostile:
    """Triangles whose corners are all the light's position."""
    return _asked(rng, np.broadcast_to(LIGHT, (n, 3, 3)), m)


def needles(rng, n: int, m: int) -> Hostile:
    """Triangles across the scene, a few steps of float32 wide."""
    ends = rng.uniform((-6, 1, -6), (6, 6, 6), (n, 2, 3))
    return _asked(rng, np.stack([ends[:, 0], ends[:, 1], ends[:, 1] + rng.integers(1, 4, (n, 3)) * 2.0**-20], 1), m)


def needles_at_light(rng, n: int, m: int) -> Hostile:
    """Needles that begin at the light."""
    away = rng.normal(size=(n, 1, 3)) * (3, 1, 3) - (0, 3, 0)
    shaken = np.concatenate([0 * away, away, away], 1)
    shaken[:, 2] += rng.integers(1, 4, (n, 3)) * 2.0**-20
    return _asked(rng, LIGHT + shaken, m)


def fan_at_light(rng, n: int, m: int) -> Hostile:
    """Ordinary triangles that share the light's position as a corner."""
    corners = rng.normal(size=(n, 3, 3)) * (2, 0.5, 2) - (0, 2, 0)
    corners[:, 0] = 0.0
    return _asked(rng, LIGHT + np.round(corners * 256) / 256, m)


def behind_light(rng, n: int, m: int) -> Hostile:
    """Ordinary triangles that share the light's position as a corner, and lie behind the light."""
    corners = rng.normal(size=(n, 3, 3)) * 2
    corners[..., 1] = 1 + abs(corners[..., 1])
    corners[:, 0] = 0.0
    return _asked(rng, LIGHT + np.round(corners * 256) / 256, m)


def copies(rng, n: int, m: int) -> Hostile:
    """One triangle, many times."""
    return _asked(rng, np.broadcast_to([[-3.0, 3, -3], [3, 3, -3], [0, 3, 4]], (n, 3, 3)), m)


def slanted_copies(rng, n: int, m: int) -> Hostile:
    """One triangle whose box is large and mostly empty, many times."""
    return _asked(rng, np.broadcast_to([[-6.0, 0.5, -6], [6, 6, 6], [6, 6.125, 6]], (n, 3, 3)), m)


def concentric(rng, n: int, m: int) -> Hostile:
    """Triangles with one centroid, and of all sizes and orientations."""
    corners = rng.normal(size=(n, 3, 3))
    corners[:, 2] = -corners[:, 0] - corners[:, 1]
    size = 2.0 ** -rng.integers(0, 16, (n, 1, 1))
    return _asked(rng, np.round(corners * 64) / 64 * size + (0, 4, 0), m)


def edge_on(rng, n: int, m: int) -> Hostile:
    """Triangles in one plane, which holds the light and half of the points."""
    bad = rng.integers(-128, 129, (n, 3, 3)) / 32.0 + (0, 4, 0)
    bad[..., 2] = 0.0
    asked = _asked(rng, bad, m)
    asked.points[::2, 2] = 0.0
    return asked


def shared_edge(rng, n: int, m: int) -> Hostile:
    """Triangles around one edge, on the way from a line of points to the light."""
    bad = rng.integers(-128, 129, (n, 3, 3)) / 32.0 + (0, 4, 0)
    bad[:, 0], bad[:, 1] = (-4, 4, 0), (4, 4, 0)
    asked = _asked(rng, bad, m)
    asked.points[::2, 2] = 0.0
    return asked


def shared_point(rng, n: int, m: int) -> Hostile:
    """Triangles around one corner, and segments through it."""
    bad = rng.integers(-128, 129, (n, 3, 3)) / 64.0
    bad[:, 0] = 0.0
    asked = _asked(rng, bad + LIGHT / 2, m)
    asked.points[::2] = 0.0
    return asked


SCENES: dict[str, Callable[..., Hostile]] = {
    made.__name__.replace("_", " "): made
    for made in (
        lines, near_lines, junk_at_light, points_at_light, needles, needles_at_light, fan_at_light, behind_light,
        copies, slanted_copies, concentric, edge_on, shared_edge, shared_point,
    )
}  # fmt: skip
"""Name -> function of (random generator, triangles, points)."""


def made(name: str, triangles: int, points: int) -> Hostile:
    """The hostile scene of a name."""
    return SCENES[name](np.random.default_rng(36), triangles, points)


class Timed(NamedTuple):
    """The time of a plan on a scene."""

    scene: str
    plan: str
    seconds: float  # of all threads, with the build of the tree; inf: not done at the limit
    occluded: int  # bits that are set


def _trace(to: Connection, name: str, sizes: tuple[int, int], plans: Sequence[str], threads: int) -> None:
    """The process of a scene: sends the `Timed` of each plan."""
    asked = made(name, *sizes)
    small = made(name, 8, 4)
    for plan in plans:
        _occluded(small, plan, threads)
        to.send(plan)
        start = process_time()
        occluded = _occluded(asked, plan, threads)
        to.send(Timed(name, plan, process_time() - start, occluded))


def _occluded(asked: Hostile, plan: str, threads: int) -> int:
    """The number of samples that are occluded."""
    scene = at.Scene.from_arrays(asked.triangles)
    seen = at.visibility(scene, asked.points, asked.lights, spp=8, plan=plan, threads=threads)
    return int(np.bitwise_count(seen.bits).sum())


def timed(name: str, sizes: tuple[int, int], plans: Sequence[str], threads: int, limit: float) -> list[Timed]:
    """The time of each plan on a scene, with the build of its tree. `limit`: seconds for each."""
    left, found = list(plans), []
    while left:
        ours, theirs = get_context("spawn").Pipe()
        child = get_context("spawn").Process(target=_trace, args=(theirs, name, sizes, left, threads))
        child.start()
        theirs.close()
        try:
            while left:
                ours.recv()  # its kernels are loaded
                found.append(ours.recv() if ours.poll(limit) else Timed(name, left[0], np.inf, -1))
                left = left[1:]
                if found[-1].seconds == np.inf:
                    break
        finally:
            child.kill()
            child.join()
    return found


def ratios(rows: Sequence[Timed]) -> dict[str, float]:
    """Plan -> times as long as the best plan, on one scene."""
    best = max(min(row.seconds for row in rows), LEAST)
    return {row.plan: max(row.seconds, LEAST) / best for row in rows}


def _report(rows: Sequence[Timed]) -> None:
    best = min(row.seconds for row in rows)
    print(f"{rows[0].scene}: {rows[0].occluded} samples occluded, best {best:.3f} s", flush=True)
    for row, ratio in zip(rows, ratios(rows).values()):
        print(f"  {row.plan:28} {row.seconds:8.3f} s {ratio:8.1f}{' <- over the bound' * (ratio > MOST)}", flush=True)


def main() -> None:
    parser = arguments(__doc__)
    parser.add_argument("--scenes", nargs="+", choices=list(SCENES), default=list(SCENES), metavar="NAME")
    parser.add_argument("--plans", nargs="+", default=[str(plan) for plan in covering_plans()], metavar="PLAN")
    parser.add_argument("--triangles", type=int, default=20_000)
    parser.add_argument("--points", type=int, default=1_000)
    parser.add_argument("--limit", type=float, default=20.0, help="seconds for each plan and scene")
    asked = parser.parse_args()
    threads = thread_count(asked.threads)
    rows = []
    for name in asked.scenes:
        rows.append(timed(name, (asked.triangles, asked.points), asked.plans, threads, asked.limit))
        _report(rows[-1])
    wrong = [row[0].scene for row in rows if len({r.occluded for r in row if np.isfinite(r.seconds)}) > 1]
    over = [f"{row.plan} on {row.scene}" for each in rows for row in each if ratios(each)[row.plan] > MOST]
    print(f"plans differ on: {', '.join(wrong) or 'no scene'}")
    print(f"over {MOST:g} times the best: {', '.join(over) or 'none'}")
    if asked.json:
        told = [row._asdict() for each in rows for row in each]
        asked.json.write_text(json.dumps({"machine": machine(threads), "rows": told}, indent=1))
    sys.exit(bool(wrong))


if __name__ == "__main__":
    main()
