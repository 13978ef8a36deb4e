"""Compares the plan `auto` with named plans, on cases drawn at random from a seed.

    python benchmarks/auto.py [--seed N] [--cases N] [--only TEXT] [--rounds N] [--threads N] [--wall] [--json FILE]
                              [--scenes NAME ...] [--lights NAME ...] [--walk FRAMES] [--plans PLAN ...]

Scenes are folders of $ANTUMBRA_SCENES, files, or such as `procedural:city?triangles=10M`.

A case is a scene, a camera (inside the scene, around it, or along a wall), a light, a number of samples per receiver,
and one of these jobs:

- `first`: the shadow rays of the first frame of a static scene, with all that they need: culling, tree and tracing.
- `kept`: the shadow rays of a later frame, with a tree that is there.
- `moving`: five frames of an animated scene.
- `points`: random points in the bounds of a scene without a tree; `surface`: random points on its surfaces.
- `walk`, with `--walk FRAMES` in place of the others: so many frames of a camera that moves ahead and turns, with all
  trees and conversions. Plans get the number of frames that follow, as from `antumbra render --frames`.

G-buffers, the vertices of a moment and the compilation of kernels are not timed. The clock is the time of all threads
of the process; `--wall` uses elapsed time. The plans of a case run in random order, and the minimum of each plan's
times counts. A plan that takes three times as long as the best is not repeated. All plans must return the same bits.

The constants of `auto` were chosen on the cases of seed 1.
"""

import argparse
import json
import sys
import tempfile
from collections.abc import Callable, Iterator
from functools import cache
from pathlib import Path
from time import perf_counter, process_time
from typing import NamedTuple, cast

import numpy as np

import antumbra as at
from antumbra.datasets.random_views import SamplingRegion, random_camera, sampling_region
from antumbra.engine.engine import Engine
from antumbra.engine.plan import DEFAULT_PLAN, parse_plan
from antumbra.engine.plan_records import precompile_plan
from antumbra.engine.sources.source_protocols import FrameMemory, moment_of
from antumbra.kernels.parallel import thread_count
from antumbra.lab.papers.benchmark_views import BenchmarkScenes, square
from antumbra.query.equal_samples import traced_samples
from antumbra.query.light_samples import light_samples
from antumbra.query.shadow_query import surface_queries
from common import machine

SCENES = BenchmarkScenes((), (), (), square(40))
STATIC = (
    "sponza_crytek", "sanmiguel_lite", "bart_robots", "bart_museum8_subdivided", "zdm2", "godot_room",
    "japanese_temple", "jungle_lowpoly", "macross_city", "delft_city", "stanford_bunny", "truck_town",
    "city", "forest", "cellar", "atrium",
)  # fmt: skip
MOVING = "synthetic_garden_foxes", "bart_robots", "swaying_city"
JOBS = "first", "first", "first", "kept", "kept", "moving", "points", "surface"
LIGHTS = "lamp", "lamps", "small", "point", "sphere", "sun", "sky", "near", "list"
DAYLIGHT = "daylight"  # a `Sky`: only with --lights
SIZES = (384, 384), (640, 360), (1024, 768)
FIRST = (
    "lbvh+multifrusta", "lbvh+packet16", "lbvh+wide", "bsah+multifrusta", "bsah+packet16", "bsah+packet16:samples",
    "bsah+wide", "tl-lbvh+multifrusta", "grid32+lbvh+multifrusta", "grid32+lbvh+packet16", "grid32+bsah+multifrusta",
    "grid32+bsah+packet16", "grid32+bsah+wide", "srdh+multifrusta", "srdh+packet16", "bsah+srdh-order+packet16",
    "cones", "grid32+cones", "bsah+chcrt",
)  # fmt: skip
KEPT = (
    "bsah+multifrusta", "bsah+packet16", "bsah+packet16:samples", "bsah+wide", "bsah+reinsert+multifrusta",
    "bsah+reinsert+packet16", "bsah+reinsert+wide", "srdh+multifrusta", "srdh+packet16", "srdh+wide",
    "bsah+srdh-order+multifrusta", "bsah+srdh-order+packet16", "bsah+chcrt", "cones",
)  # fmt: skip
LISTED = "bsah+multifrusta:by-sample", "bsah+packet16:blocks", "bsah+wide:samples"  # for many samples
REFITTED = "bsah+refit+multifrusta", "bsah+refit+packet16", "bsah+refit+wide", "grid32+bsah+refit+multifrusta"
FRAMES, SLOW = 5, 3.0
WARM, WARM_SECONDS = 40, 3.0  # frames and seconds before a kept frame
HELD_OUT = "sponza_crytek", "zdm2", "godot_room", "macross_city", "delft_city", "cellar", "synthetic_garden_foxes"


STEP, TURN = 1.0 / 300.0, np.radians(1.0)  # of a walk per frame: in radii of the scene, and about its up axis


class Case(NamedTuple):
    """One case; `seed` determines its camera, points and light."""

    scene: str  # folder of $ANTUMBRA_SCENES, or a procedural scene
    job: str
    camera: str  # inside, around or wall
    light: str
    spp: int
    size: tuple[int, int]  # of the picture; the number of points is the product
    seed: int
    frames: int = FRAMES  # of a walk, or of an animated scene

    def __str__(self) -> str:
        size = f"{self.size[0]}x{self.size[1]}"
        return f"{self.scene[:22]:22s} {self.job:7s} {self.camera:6s} {self.light:5s} {self.spp:2d} {size:9s}"


class Draw(NamedTuple):
    """What cases are drawn from."""

    static: tuple[str, ...] = STATIC
    moving: tuple[str, ...] = MOVING
    size: tuple[int, int] | None = None  # None: one of SIZES, and 128 to 131,072 points
    lights: tuple[str, ...] = LIGHTS
    walk: int = 0  # frames of walks, which replace all other jobs; 0: no walks


EVERYTHING = Draw()


def draw_cases(seed: int, count: int, draw: Draw = EVERYTHING) -> Iterator[Case]:
    """The cases of a seed."""
    rng = np.random.default_rng(seed)
    for k in range(count):
        job = "walk" if draw.walk else JOBS[k % len(JOBS)]
        scene = str(rng.choice(draw.moving if job == "moving" else draw.static))
        camera, light = str(rng.choice(("inside", "around", "wall"))), draw.lights[int(rng.integers(len(draw.lights)))]
        spp, size = int(rng.choice((1, 4, 16))), SIZES[int(rng.integers(len(SIZES)))]
        if job in ("points", "surface"):
            size = int(2 ** rng.uniform(7, 17)), 1
        size = draw.size or size
        yield Case(scene, job, camera, light, spp, size, 1000 * seed + k, draw.walk or FRAMES)


# --- scenes, cameras, lights and points -------------------------------------------------------------------------------


@cache
def region_of(name: str) -> SamplingRegion:
    """The scene of a name, with the region of its random cameras."""
    if name == "swaying_city":
        return sampling_region(swaying_city(), 0.0, None)
    return sampling_region(SCENES.view(name, (64, 64)).scene, 0.0, None)


def swaying_city() -> at.Scene:
    """A city of 500,000 triangles that sways in the wind: eight frames of all its vertices."""
    still = at.procedural("city").triangles(0.0)
    corners = still.vertices.reshape(-1, 3)
    sway = 0.02 * (corners[:, 1] - corners[:, 1].min())
    frames = np.stack([corners + np.outer(sway * np.sin(2.0 * np.pi * k / 8), [1.0, 0.0, 0.4]) for k in range(8)])
    with tempfile.TemporaryDirectory() as folder:
        np.save(Path(folder, "frames.npy"), frames)
        np.save(Path(folder, "faces.npy"), np.arange(len(corners)).reshape(-1, 3))
        return cast(at.Scene, at.load(folder))


def camera_of(case: Case, region: SamplingRegion) -> at.Camera:
    """The camera of a case."""
    if case.camera == "wall":
        for k in range(64):
            point, normal = (each[0] for each in surface_points(region, 1, case.seed + k))
            along = np.cross(normal, np.eye(3)[1 if region.scene.up == "y" else 2])
            position = point + 0.01 * region.radius * normal
            if np.linalg.norm(along) > 0.5 and not region.walled(position, 0.005 * region.radius):
                up = np.eye(3)[1 if region.scene.up == "y" else 2]
                return at.Camera(position, position + along, up, 60.0, *case.size)
    return random_camera(region, case.seed, int(case.camera == "around"), case.size)


def surface_points(region: SamplingRegion, n: int, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """n random points on the surfaces of a scene, and their normals, (n, 3) float64 each."""
    rng, triangles = np.random.default_rng(seed), region.scene.triangles(0.0)
    corners = triangles.vertices.astype(float)
    across = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    area = np.linalg.norm(across, axis=1)
    some = rng.choice(len(area), n, p=area / area.sum())
    points = (corners[some] * rng.dirichlet([1, 1, 1], n)[:, :, None]).sum(1) + triangles.origin
    return points, across[some] / area[some, None]


def lights_of(case: Case, region: SamplingRegion) -> list[at.Light]:
    """The lights of a case: lamps hang at random places of the upper half of the bounds."""
    rng, radius = np.random.default_rng(case.seed), region.radius
    upward = 1 if region.scene.up == "y" else 2
    up, side = np.eye(3)[upward], np.eye(3)[0]
    across = np.cross(up, side)

    def place() -> np.ndarray:
        low, high = region.bounds.copy()
        low[upward] = (low + high)[upward] / 2.0
        return rng.uniform(low, high)

    def lamp(edge: float) -> at.QuadLight:
        return at.QuadLight(place() - edge * (side + across) / 2.0, edge * side, edge * across)

    turn, height = rng.uniform(0.0, 2.0 * np.pi), rng.uniform(0.3, 1.4)
    towards = np.cos(height) * (np.cos(turn) * side + np.sin(turn) * across) + np.sin(height) * up
    return {
        "lamp": lambda: [lamp(radius / 10.0)],
        "lamps": lambda: [lamp(radius / 10.0), lamp(radius / 10.0)],
        "small": lambda: [lamp(radius / 40.0)],
        "point": lambda: [at.PointLight(place())],
        "sphere": lambda: [at.SphereLight(place(), radius / 40.0)],
        "list": lambda: [at.PointLights([place() for _ in range(24)], interleave=False)],
        "sun": lambda: [at.DirectionalLight(-towards)],
        "sky": lambda: [at.AmbientOcclusion()],
        DAYLIGHT: lambda: [at.Sky()],
        "near": lambda: [at.AmbientOcclusion(radius / 15.0)],
    }[case.light]()


# --- one case by one plan ---------------------------------------------------------------------------------------------

Clock = Callable[[], float]
"""Seconds."""


def trace_frame(engine: Engine, case: Case, time: float, clock: Clock, step: int = 0) -> tuple[float, list[np.ndarray]]:
    """(seconds, bits) of the shadow rays of one frame; `step`: frames that the camera has walked."""
    region = region_of(case.scene)
    lights, camera = lights_of(case, region), view_of(case, step)
    samples = [light_samples(light, case.spp) for light in lights]
    tracer, pixels = engine.frame_tracer(), case.size[0] * case.size[1]
    rays = pixels * sum(map(traced_samples, lights, samples))
    frames = case.frames - step if case.job == "walk" else 1
    tracer.begin(FrameMemory(0, 0, 0), rays, 0, time, frames)
    for rows in tracer.bands(camera.height):
        surfaces = tracer.surfaces(camera, rows)
        queries = surface_queries(surfaces, lights, samples, 0, engine.threads)
        start = clock()
        tracer.sample(surfaces.gbuffer, queries, lights, samples, 0)
        tracer.prepare(queries, lambda step: None)
        bits = engine.accelerator.answer_all(tracer.tree, queries)
        seconds = clock() - start
    return seconds, bits


@cache
def view_of(case: Case, step: int = 0) -> at.Camera:
    """`camera_of` a case, after some frames of a walk."""
    region = region_of(case.scene)
    camera, up = camera_of(case, region), np.eye(3)["xyz".index(region.scene.up)]
    for _ in range(step):
        ahead = camera.target - camera.position
        turned = np.cos(TURN) * ahead + np.sin(TURN) * np.cross(up, ahead) + (1.0 - np.cos(TURN)) * (up @ ahead) * up
        position = camera.position + STEP * region.radius * ahead / np.linalg.norm(ahead)
        camera = at.Camera(position, position + turned, camera.up, camera.vfov, *case.size)
    return camera


def trace_kept(engine: Engine, case: Case, clock: Clock) -> tuple[float, list[np.ndarray]]:
    """(seconds, bits) of the shadow rays of a frame, with a tree built before."""
    if engine.plan.trace in ("auto", "chcrt"):  # they keep state from frame to frame
        warm, end = 0, clock() + WARM_SECONDS
        while warm < WARM and clock() < end:
            trace_frame(engine, case, 0.0, clock)
            warm += 1
        return min((trace_frame(engine, case, 0.0, clock) for _ in range(2)), key=lambda answer: answer[0])
    region, tracer = region_of(case.scene), engine.frame_tracer()
    lights = lights_of(case, region)
    samples = [light_samples(light, case.spp) for light in lights]
    tracer.begin(FrameMemory(0, 0, 0), 0, 0, 0.0)
    surfaces = tracer.surfaces(view_of(case), slice(0, case.size[1]))
    queries = surface_queries(surfaces, lights, samples, 0, engine.threads)
    tracer.sample(surfaces.gbuffer, queries, lights, samples, 0)
    tracer.prepare(queries, lambda step: None)
    seconds = []
    for _ in range(2):
        start = clock()
        bits = engine.accelerator.answer_all(tracer.tree, queries)
        seconds.append(clock() - start)
    return min(seconds), bits


def receivers_of(case: Case) -> at.Receivers:
    """The points of a case."""
    region, n = region_of(case.scene), case.size[0] * case.size[1]
    points, normals = surface_points(region, n, case.seed)
    if case.job == "points":
        points = np.random.default_rng(case.seed).uniform(*region.bounds, (n, 3))
    return at.Receivers.of(points, normals, region.scene.origin, region.scene.middle)


def trace_points(engine: Engine, case: Case, clock: Clock) -> tuple[float, list[np.ndarray]]:
    """(seconds, bits) of a query of points."""
    receivers, lights = receivers_of(case), lights_of(case, region_of(case.scene))
    moment_of(engine.source, 0.0)
    start = clock()
    answer = engine.visibility(receivers, lights, spp=case.spp)
    return clock() - start, [answer.bits]


def run_case(case: Case, plan: str, threads: int, clock: Clock) -> tuple[float, list[np.ndarray]]:
    """(seconds, bits of the last frame) of a case by a plan."""
    scene = region_of(case.scene).scene
    engine = Engine(scene, plan, threads, gbuffer="raster")
    if case.job == "first":
        return trace_frame(engine, case, 0.0, clock)
    if case.job == "kept":
        return trace_kept(engine, case, clock)
    if case.job in ("moving", "walk"):
        times = scene.duration * np.arange(case.frames) / case.frames
        steps = range(case.frames) if case.job == "walk" else [0] * case.frames
        frames = [trace_frame(engine, case, float(time), clock, step) for time, step in zip(times, steps)]
        return sum(seconds for seconds, _ in frames), frames[-1][1]
    return trace_points(engine, case, clock)


def plans_of(case: Case) -> list[str]:
    """The plans of a case, `auto` first."""
    if case.job == "moving":
        plans = [plan for plan in FIRST if "srdh" not in plan and "chcrt" not in plan]
        return [DEFAULT_PLAN, *plans, *REFITTED]
    more = LISTED if case.light in ("list", "sky", DAYLIGHT) else ()
    if case.job == "walk":
        return [DEFAULT_PLAN, "lbvh+packet16", "lbvh+multifrusta", *KEPT, *more]
    return [DEFAULT_PLAN, *((*KEPT, *more) if case.job == "kept" else FIRST)]


def measure(case: Case, plans: list[str], threads: int, rounds: int, clock: Clock) -> dict[str, float]:
    """Plan -> minimum seconds of a case.

    Raises
    ------
    RuntimeError
        If two plans give different bits.
    """
    rng, seconds_of = np.random.default_rng(0), dict[str, float]()
    _, reference = run_case(case, DEFAULT_PLAN, threads, clock)  # not counted: it reads the scene
    for _ in range(rounds):
        for plan in rng.permutation(plans).tolist():
            if seconds_of.get(plan, 0.0) > SLOW * min(seconds_of.values(), default=0.0):
                continue
            seconds, bits = run_case(case, plan, threads, clock)
            if not all(np.array_equal(a, b) for a, b in zip(reference, bits)):
                raise RuntimeError(f"{case}: {plan} and {DEFAULT_PLAN} give different bits")
            seconds_of[plan] = min(seconds, seconds_of.get(plan, np.inf))
    return seconds_of


# --- report -----------------------------------------------------------------------------------------------------------

Row = tuple[Case, dict[str, float]]


def report(rows: list[Row]) -> None:
    """Print the ratios of `auto` and the best plan, for all cases and for parts of them."""
    parts: dict[str, Callable[[Case], bool]] = {"all": lambda case: True}
    parts |= {job: lambda case, job=job: case.job == job for job in (*dict.fromkeys(JOBS), "walk")}
    parts |= {light: lambda case, light=light: case.light == light for light in (*LIGHTS, DAYLIGHT)}
    parts["scenes not in the fit"] = lambda case: case.scene in HELD_OUT
    print("\nauto / best plan:")
    for name, belongs in parts.items():
        some = [seconds for case, seconds in rows if belongs(case)]
        if some:
            ratios = np.array([each[DEFAULT_PLAN] / best(each)[1] for each in some])
            long = np.array([each[DEFAULT_PLAN] > 0.01 for each in some])
            worst = ratios[long].max() if long.any() else np.nan
            mean = np.exp(np.log(ratios).mean())
            print(f"  {name:22s} geometric mean {mean:5.3f}, worst over 10 ms {worst:5.2f} ({len(some)} cases)")
    wins: dict[str, int] = {}
    for _, seconds in rows:
        plan = best(seconds)[0]
        wins[plan] = wins.get(plan, 0) + 1
    print(
        "best plan of the cases: " + ", ".join(f"{plan} {n}" for plan, n in sorted(wins.items(), key=lambda p: -p[1]))
    )


def best(seconds: dict[str, float]) -> tuple[str, float]:
    """(name, seconds) of the fastest named plan."""
    return min(((plan, s) for plan, s in seconds.items() if plan != DEFAULT_PLAN), key=lambda pair: pair[1])


def arguments(seed: int, cases: int) -> argparse.ArgumentParser:
    """A parser with the options of `cases_of`."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seed", type=int, default=seed)
    parser.add_argument("--cases", type=int, default=cases)
    parser.add_argument("--only", default="", help="cases whose line contains this text")
    parser.add_argument("--scenes", nargs="+", help="draw from these scenes only")
    parser.add_argument("--size", type=int, nargs=2, help="of all pictures; the number of points is the product")
    parser.add_argument("--lights", nargs="+", choices=[*LIGHTS, DAYLIGHT], default=LIGHTS, help="draw from these")
    parser.add_argument("--walk", type=int, default=0, metavar="FRAMES", help="draw walks of so many frames")
    return parser


def cases_of(options: argparse.Namespace) -> list[Case]:
    """The cases that the options select."""
    scenes = tuple(options.scenes or ())
    size = options.size and tuple(options.size)
    draw = Draw(scenes or STATIC, scenes or MOVING, size, tuple(options.lights), options.walk)
    return [case for case in draw_cases(options.seed, options.cases, draw) if options.only in str(case)]


def main() -> None:
    parser = arguments(2, 208)
    parser.add_argument("--rounds", type=int, default=2)
    parser.add_argument("--threads", type=int, default=thread_count(None))
    parser.add_argument("--wall", action="store_true", help="measure elapsed time")
    parser.add_argument("--plans", nargs="+", help="compare with these only")
    parser.add_argument("--json", type=Path)
    options = parser.parse_args()
    clock = perf_counter if options.wall else process_time
    cases = cases_of(options)
    plans = {case: [DEFAULT_PLAN, *options.plans] if options.plans else plans_of(case) for case in cases}
    for plan in dict.fromkeys(plan for of_case in plans.values() for plan in of_case):
        precompile_plan(parse_plan(plan), "raster")
    rows = list[Row]()
    for case in cases:
        try:
            seconds = measure(case, plans[case], options.threads, options.rounds, clock)
        except at.InputError as error:
            print(f"skipped: {case}: {error}", file=sys.stderr)
            continue
        rows.append((case, seconds))
        plan, least = best(seconds)
        auto = seconds[DEFAULT_PLAN]
        print(f"{case} {1e3 * auto:8.1f} ms, {auto / least:5.2f} x {plan}", flush=True)
        if options.json:
            answer = {"machine": machine(options.threads), "rows": [{**c._asdict(), "seconds": s} for c, s in rows]}
            options.json.write_text(json.dumps(answer, indent=1))
    report(rows)


if __name__ == "__main__":
    main()
