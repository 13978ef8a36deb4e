"""The plan `auto` beside named plans, on cases that took no part in fitting its rates: `auto_cases.json`.

    python benchmarks/auto.py [--cases FILE] [--only TEXT] [--rounds N] [--threads N] [--json FILE]

A case is a scene, a light, rays a receiver, and one of these jobs:

- `picture`: one frame, as `antumbra.render` makes it.
- `walk`: six frames of a static scene by one `Renderer`; the camera turns.
- `animation`: six frames of a moving scene by one `Renderer`.
- `bounce`: one frame with four diffuse rays a pixel.
- `points`, `surface`, `grid`, `shuffled`: `antumbra.visibility` of points, of a scene that has no tree yet. The points
  are random in the scene's box, random on its surfaces, a level grid, and the same grid in random order.

The time of a case is that of the whole job: trees, culling, G-buffers and tracing. Evaluating the scene is not counted.
Plans take turns in random order, and the least of their times counts. A plan that takes three times as long as the best
in the first round has no second. All bits must be the same.
"""

import argparse
import json
import sys
from pathlib import Path
from time import perf_counter
from typing import NamedTuple

import numpy as np

import antumbra as at
from antumbra.engine.plan import DEFAULT_PLAN, parse_plan
from antumbra.kernels.parallel import thread_count
from antumbra.papers.benchmark_views import named_view, square
from antumbra.picture.render_kernels import precompile_indirect, precompile_plan
from antumbra.picture.renderer import Renderer
from common import machine

CASES = Path(__file__).with_name("auto_cases.json")
TREES = "bsah", "lbvh", "tl-lbvh"
TRACERS = "multifrusta", "packet16", "packet16:samples", "wide", "single"
PICTURES = [f"{tree}+{tracer}" for tree in TREES[:2] for tracer in TRACERS]
PICTURES += ["tl-lbvh+multifrusta", "grid32+lbvh+multifrusta", "grid32+bsah+multifrusta", "cones"]
MOVING = ["bsah+refit+multifrusta", "bsah+refit+wide"]
POINTS = [f"{tree}+{tracer}" for tree in TREES[:2] for tracer in TRACERS]
FRAMES, SLOW = 6, 3.0


class Case(NamedTuple):
    """A line of the file of cases."""

    scene: str  # folder of $ANTUMBRA_SCENES, or a procedural scene
    job: str
    light: str  # lamp, small, large, point, sphere, sun, sky, near or list
    spp: int
    size: tuple[int, int]  # of the picture; the number of points is the product


def load_cases(path: Path = CASES) -> list[Case]:
    return [Case(**{**told, "size": tuple(told["size"])}) for told in json.loads(path.read_text())]


def light_of(name: str, view, rng) -> at.Light:
    """The light of a case; lamps are squares around the first light of the view."""
    bounds = view.scene.bounds
    diagonal, lamp = float(np.linalg.norm(np.ptp(bounds, axis=0))), view.lights[0]
    up = np.eye(3)[1 if view.scene.up == "y" else 2]
    side = np.array([1.0, 0.0, 0.0])
    if not isinstance(lamp, at.QuadLight):
        corner = bounds.mean(0) + 0.4 * diagonal * up
        lamp = at.QuadLight(corner, side * diagonal / 40, np.cross(up, side) * diagonal / 40)
    centre = lamp.corner + (lamp.u + lamp.v) / 2
    scaled = lambda k: at.QuadLight(centre - (lamp.u + lamp.v) * k / 2, lamp.u * k, lamp.v * k)
    return {
        "lamp": lambda: lamp, "small": lambda: scaled(0.25), "large": lambda: scaled(4.0),
        "point": lambda: at.PointLight(centre), "sphere": lambda: at.SphereLight(centre, diagonal / 80),
        "sun": lambda: at.DirectionalLight(-(up + 0.5 * side)), "sky": at.AmbientOcclusion,
        "near": lambda: at.AmbientOcclusion(diagonal / 30),
        "list": lambda: at.PointLights(bounds[0] + rng.random((48, 3)) * np.ptp(bounds, axis=0), interleave=False),
    }[name]()  # fmt: skip


def points_of(case: Case, scene, rng) -> tuple[np.ndarray, np.ndarray]:
    """(points, normals) of a case."""
    bounds, n = scene.bounds, case.size[0] * case.size[1]
    axis = 1 if scene.up == "y" else 2
    up = np.eye(3)[axis]
    if case.job == "points":
        return bounds[0] + rng.random((n, 3)) * np.ptp(bounds, axis=0), up
    if case.job == "surface":
        corners = scene.triangles(0.0).vertices.astype(float)
        across = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        area = np.linalg.norm(across, axis=1)
        some = rng.choice(len(area), n, p=area / area.sum())
        points = (corners[some] * rng.dirichlet([1, 1, 1], n)[:, :, None]).sum(1) + scene.origin
        return points, across[some] / area[some, None]
    level = [k for k in range(3) if k != axis]
    grid = np.empty((*case.size, 3))
    grid[..., axis] = bounds[0][axis] + 0.08 * np.ptp(bounds[:, axis])
    lines = [bounds[0][k] + np.ptp(bounds[:, k]) * np.linspace(0.2, 0.8, m) for k, m in zip(level, case.size)]
    grid[..., level[0]], grid[..., level[1]] = np.meshgrid(*lines, indexing="ij")
    points = grid.reshape(-1, 3)
    return (rng.permutation(points) if case.job == "shuffled" else points), up


def plans_of(case: Case) -> list[str]:
    """The plans of a case, `auto` first."""
    if case.job in ("points", "surface", "grid", "shuffled"):
        return [DEFAULT_PLAN, *POINTS]
    return [DEFAULT_PLAN, *PICTURES, *(MOVING if case.job == "animation" else [])]


def run_case(case: Case, view, plan: str, threads: int) -> tuple[float, list[np.ndarray]]:
    """(seconds, bits of the last frame) of a case by a plan."""
    rng = np.random.default_rng(1)
    light, scene = light_of(case.light, view, rng), view.scene
    if case.job in ("points", "surface", "grid", "shuffled"):
        points, normals = points_of(case, scene, rng)
        engine = at.Engine(scene, plan, threads)
        start = perf_counter()
        receivers = at.Receivers.of(points, normals, scene.origin)
        seen = engine.visibility(receivers, [light], spp=case.spp)
        return perf_counter() - start, [seen.bits]
    renderer, seconds = Renderer(scene, plan, threads), 0.0
    for k in range(1 if case.job in ("picture", "bounce") else FRAMES):
        camera, time = view.camera.resized(*case.size), 0.0
        if case.job == "walk":
            aside = 0.02 * k * np.cross(camera.target - camera.position, camera.up)
            camera = at.Camera(camera.position, camera.target + aside, camera.up, camera.vfov, *case.size)
        if case.job == "animation":
            time = scene.duration * k / FRAMES
        frame = renderer.render(camera, [light], spp=case.spp, time=time, bounce=4 if case.job == "bounce" else None)
        seconds += frame.timings["total"] - frame.timings["evaluate"]
    return seconds, frame.bits


def measure(case: Case, threads: int, rounds: int) -> dict[str, float]:
    """Plan -> least seconds of a case.

    Raises
    ------
    RuntimeError
        If two plans give different bits.
    """
    view, rng = named_view(case.scene, case.size, square(40)), np.random.default_rng(0)
    found: dict[str, float] = {}
    _, truth = run_case(case, view, "lbvh+single", threads)  # the first run warms the machine up
    for _ in range(rounds):
        for plan in rng.permutation(plans_of(case)).tolist():
            if found.get(plan, 0.0) > SLOW * min(found.values(), default=0.0):
                continue
            seconds, bits = run_case(case, view, plan, threads)
            if not all(np.array_equal(a, b) for a, b in zip(truth, bits)):
                raise RuntimeError(f"{case}: {plan} and {DEFAULT_PLAN} give different bits")
            found[plan] = min(seconds, found.get(plan, np.inf))
    return found


def report(rows: list[tuple[Case, dict[str, float]]]) -> None:
    """Print the summary: total times, and the worst cases."""
    chosen = np.array([found[DEFAULT_PLAN] for _, found in rows])
    best = np.array([min(found.values()) for _, found in rows])
    ratios = chosen / best
    print(f"\n{len(rows)} cases: auto {chosen.sum():.2f} s, the best plan of each case {best.sum():.2f} s:", end=" ")
    print(f"ratio {chosen.sum() / best.sum():.3f}; worst case {ratios.max():.2f}, median {np.median(ratios):.2f}")
    for plan in dict.fromkeys(plan for _, found in rows for plan in found):
        there = [found[plan] / min(found.values()) for _, found in rows if plan in found]
        print(f"  {plan:28s} worst {max(there):8.2f}, median {np.median(there):5.2f} ({len(there)} cases)")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--cases", type=Path, default=CASES)
    parser.add_argument("--only", default="", help="cases whose line contains this text")
    parser.add_argument("--rounds", type=int, default=2)
    parser.add_argument("--threads", type=int, default=thread_count(None))
    parser.add_argument("--json", type=Path)
    options = parser.parse_args()
    cases = [case for case in load_cases(options.cases) if options.only in str(case)]
    for plan in dict.fromkeys(plan for case in cases for plan in plans_of(case)):
        precompile_plan(parse_plan(plan), "raster")
    precompile_indirect("raster")
    rows = []
    for case in cases:
        try:
            found = measure(case, options.threads, options.rounds)
        except at.InputError as error:
            print(f"left out: {error}", file=sys.stderr)
            continue
        rows.append((case, found))
        best = min(found, key=found.__getitem__)
        what = f"{case.scene[:24]:24s} {case.job:9s} {case.light:6s} {case.spp:4d} {case.size[0]:4d}x{case.size[1]:<4d}"
        auto = found[DEFAULT_PLAN]
        print(f"{what} {1e3 * auto:8.1f} ms, {auto / found[best]:5.2f} x {best}", flush=True)
    report(rows)
    if options.json:
        answer = {"machine": machine(options.threads), "rows": [{**c._asdict(), "seconds": s} for c, s in rows]}
        options.json.write_text(json.dumps(answer, indent=1))


if __name__ == "__main__":
    main()
