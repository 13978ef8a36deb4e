"""Rays, soft shadows and builds on a device beside the CPU, with the bits of both compared first.

    python benchmarks/device.py --device cuda|opencl|host [scene ...]
        [--part rays|shafts|build|frame|cutouts|copies|store ...] [--rays N] [--triangles N ...] [--size W H] [--spp N]
        [--store FILE] [--device-memory SIZE] [--kind KIND ...] [--walk near|far ...] [--frames N]
        [--threads N] [--rounds N] [--json FILE|auto]

The part `build` is described in device_build.py, `frame` in device_frame.py, `cutouts` and `copies` in
device_surfaces.py, and `store`, which is measured only if it is named, in device_store.py. The part `rays` follows.
The part `shafts` has the shadow passes of a small and a large lamp, with one sample and with --spp, by the method
`device, shafts` (the plan `bsah+multifrusta+device:NAME`) beside single rays and the CPU. `visits` are nodes visited
per 16 rays, by one subgroup of shafts together; for single rays, the CPU's `single` counts them.

A scene is sponza_crytek, sanmiguel_lite, bart_robots ($ANTUMBRA_SCENES), forest (procedural), or a file that
`antumbra.load` reads. Without scenes, all of these that are there.

Cases:

- `coherent`: segments from the visible surfaces of a picture, row by row, to the middle of a light
- `random`: segments between random pairs of points in the scene's bounds
- `hostile`: segments through vertices, along edges and to corners, of which float32 decides few
- `closest`: nearest hits of rays through random pairs of points
- `soft`: the shadow pass of a picture with an area light, from receivers on the host to bits on the host

Methods:

- `device`: rays are on the device, answers stay there
- `device, host arrays`: rays are copied there, and answers back; for shadow passes, the only method with single rays
- `cpu`: the same rays by `Scene.occluded` or `closest_hit`; for `soft`, the plan `bsah+reinsert+multifrusta`
- `warp`: NVIDIA Warp's `mesh_query_ray_anyhit` on the device, if it is installed and the device is a CUDA card

Every method is called once before it is timed; times are medians of --rounds calls. `differs` counts the answers that
differ from the CPU's: ours must be 0, or the exit status is 1. `undecided` are the tests that float32 leaves open, and
`on cpu` those that float64 leaves, per million rays. With --json auto, the file is docs/results/device-NAME.json, with
the card's name.
"""

import argparse
import json
import re
import statistics
import sys
import time
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

import antumbra
import device_build
import device_frame
import device_store
import device_surfaces
from antumbra.base.errors import InputError
from antumbra.cli.arguments import parse_bytes
from antumbra.devices.arrays import DeviceArray
from antumbra.devices.device import Device
from antumbra.engine.device_tracers import device_tracer
from antumbra.engine.engine import Engine
from antumbra.engine.plan import parse_plan
from antumbra.engine.sources.paged_source import DEVICE_CHUNKS
from antumbra.kernels.parallel import thread_count
from antumbra.query.shadow_query import ShadowQuery, ray_count, segments
from antumbra.trace.counters import NODES, new_counters
from antumbra.trace.device.device_tracer import DeviceTracer
from common import installed, machine
from peers import warp_rays
from peers.ray_contest import query_of
from views import VIEWS, View, views

CPU_PLAN = "bsah+reinsert+multifrusta"
PARTS = ["build", "frame", *device_surfaces.SCENES, "shafts", "rays"]
STORE = "store"
RESULTS = Path(__file__).resolve().parents[1] / "docs" / "results"
COLUMNS = "undecided", "on cpu", "visits"
HEAD = f"{'case':9s} {'method':20s} {'Mrays/s':>9s} {'ms':>9s} {'differs':>8s}" + "".join(f" {c:>9s}" for c in COLUMNS)


class Ours(NamedTuple):
    """A scene on a device and on the CPU."""

    scene: antumbra.Scene
    engine: Engine  # on the device
    tracer: DeviceTracer
    threads: int
    rounds: int

    @property
    def device(self) -> Device:
        return self.tracer.device


# --- Rays -------------------------------------------------------------------------------------------------------------


Ends = tuple[np.ndarray, np.ndarray]
"""(origins, targets), (n, 3) float32 each, world."""


def coherent(query: ShadowQuery, origin: np.ndarray, n: int) -> Ends:
    """Segments of a picture's receivers to the first sample of its light, repeated up to n."""
    ends, above = segments(query)
    seen = above[..., 0]
    both = query.origins[seen] + origin, ends[seen][:, 0] + origin
    return np.resize(both[0], (n, 3)).astype(np.float32), np.resize(both[1], (n, 3)).astype(np.float32)


def between_random_points(bounds: np.ndarray, n: int) -> Ends:
    origins, targets = np.random.default_rng(2).uniform(*bounds, (2, n, 3)).astype(np.float32)
    return origins, targets


def hostile(vertices: np.ndarray, bounds: np.ndarray, n: int) -> Ends:
    """To corners and through them, to middles of edges, along edges, and from corners to corners; vertices: world."""
    rng = np.random.default_rng(3)
    origins, _ = between_random_points(bounds, n)
    a, b, c = vertices[rng.integers(0, len(vertices), n)].swapaxes(0, 1)
    kind, s = rng.integers(0, 5, (n, 1)), rng.random((n, 1))
    targets = np.select([kind == k for k in range(4)], [a, (a + b) / 2, 2 * a - origins, b + (b - a) * s], c)
    origins = np.where(kind == 3, a + (a - b) * s, np.where(kind == 4, a, origins))
    return origins.astype(np.float32), targets.astype(np.float32)


# --- Times ------------------------------------------------------------------------------------------------------------


class Timing(NamedTuple):
    """The answers of a method, and the seconds of each call."""

    answers: Any
    seconds: list[float]


def timed(call: Callable[[], Any], rounds: int) -> Timing:
    """Call a method once before the clock starts, then `rounds` times."""
    answers, seconds = call(), []
    for _ in range(rounds):
        start = time.perf_counter()
        answers = call()
        seconds.append(time.perf_counter() - start)
    return Timing(answers, seconds)


def on_device(device: Device, array: np.ndarray) -> DeviceArray:
    return DeviceArray(device.upload(array, "the rays"), array.shape, array.dtype, device.queue)


def differing(ours: Any, theirs: Any) -> int:
    """The number of rays whose answers differ; answers: an array, or a tuple of arrays."""
    pairs = zip(ours, theirs) if isinstance(ours, tuple) else [(ours, theirs)]
    return int(np.logical_or.reduce([a != b for a, b in pairs]).sum())


def row(case: dict[str, Any], method: str, timing: Timing, n: int, truth: Any) -> dict[str, Any]:
    """A row of the table."""
    mrays = n / statistics.median(timing.seconds) / 1e6
    wrong = differing(timing.answers, truth)
    return {**case, "method": method, "rays": n, "seconds": timing.seconds, "mrays": mrays, "differs": wrong}


def line(each: dict[str, Any]) -> str:
    """A row as a line of the table."""
    left = "".join(f" {each[name]:9.1f}" if name in each else 10 * " " for name in COLUMNS)
    ms = statistics.median(each["seconds"]) * 1e3
    head = f"{each['case']:9s} {each['method']:20s} {each['mrays']:9.2f} {ms:9.2f} {each['differs']:8d}"
    copied = [f"{each[name] / 1e6:.3f} MB {name}" for name in ("uploaded", "downloaded") if name in each]
    return f"{head}{left} {', '.join(copied)}".rstrip()


def step_line(each: dict[str, Any]) -> str:
    """A step of a build as a line: kernel, launches, time and the rate of its memory."""
    seconds = each["seconds"][0]
    rate = each["bytes"] / max(seconds, 1e-9) / 1e9
    return f"  {each['kernel']:16s} {each['launches']:4d} launches {seconds * 1e3:9.3f} ms {rate:9.2f} GB/s"


# --- Cases ------------------------------------------------------------------------------------------------------------


def counted(ours: Ours, n: int, call: Callable[[], Any]) -> dict[str, float]:
    """The tests per million rays that float32, and float64, leave open in a call."""
    before = ours.tracer.undecided, ours.tracer.on_cpu
    call()
    after = ours.tracer.undecided, ours.tracer.on_cpu
    return {name: 1e6 * (b - a) / n for name, a, b in zip(("undecided", "on cpu"), before, after)}


def segment_rows(case: dict[str, Any], ours: Ours, ends: Ends) -> Iterator[dict[str, Any]]:
    """Rows of a list of segments."""
    (origins, targets), n, device = ends, len(ends[0]), ours.device
    there = on_device(device, origins), on_device(device, targets)

    def resident() -> DeviceArray:
        blocked = ours.engine.occluded(there[0], targets=there[1], threads=ours.threads)
        device.synchronise()
        return blocked

    left = counted(ours, n, resident)
    on_cpu = timed(lambda: ours.scene.occluded(origins, targets=targets, threads=ours.threads), ours.rounds)
    timing, truth = timed(resident, ours.rounds), on_cpu.answers
    yield row(case, "device", timing._replace(answers=timing.answers.numpy()), n, truth) | left
    copied = timed(lambda: ours.engine.occluded(origins, targets=targets, threads=ours.threads), ours.rounds)
    yield row(case, "device, host arrays", copied, n, truth)
    yield row(case, "cpu", on_cpu, n, truth)
    if device.kind == "cuda" and installed(warp_rays.library):
        vertices, frame = ours.scene.triangles().vertices, ours.scene.origin
        local = [(points.astype(np.float64) - frame).astype(np.float32) for points in ends]
        rays = warp_rays.Segments(vertices, *local, f"cuda:{device.ordinal}")
        yield row(case, "warp", timed(rays.blocked, ours.rounds)._replace(answers=rays.answers()), n, truth)


def closest_rows(case: dict[str, Any], ours: Ours, ends: Ends) -> Iterator[dict[str, Any]]:
    """Rows of the nearest hits of rays through pairs of points."""
    origins, directions, n, device = ends[0], ends[1] - ends[0], len(ends[0]), ours.device
    there = on_device(device, origins), on_device(device, directions)

    def resident() -> tuple[DeviceArray, ...]:
        hit = ours.engine.closest_hit(*there, threads=ours.threads)
        device.synchronise()
        return hit.face, hit.t

    def of_engine(engine: Any) -> tuple[np.ndarray, ...]:
        hit = engine.closest_hit(origins, directions, threads=ours.threads)
        return hit.face, hit.t

    left = counted(ours, n, resident)
    on_cpu = timed(lambda: of_engine(ours.scene), ours.rounds)
    timing, truth = timed(resident, ours.rounds), on_cpu.answers
    yield row(case, "device", timing._replace(answers=tuple(a.numpy() for a in timing.answers)), n, truth) | left
    yield row(case, "device, host arrays", timed(lambda: of_engine(ours.engine), ours.rounds), n, truth)
    yield row(case, "cpu", on_cpu, n, truth)


def pass_rows(case: dict[str, Any], ours: Ours, query: ShadowQuery, shafts: bool) -> Iterator[dict[str, Any]]:
    """Rows of a shadow pass, from receivers on the host to bits on the host; shafts: also by them, with visits."""
    plans = {"device, host arrays": ours.engine.plan, "cpu": parse_plan(CPU_PLAN)}
    if shafts:
        plans["device, shafts"] = parse_plan(f"bsah+multifrusta+device:{ours.engine.plan.device}")
    n, timings, left = ray_count(query), {}, {}
    for name, plan in plans.items():
        engine = ours.engine if plan == ours.engine.plan else Engine(ours.scene, plan, ours.threads)
        answer = answer_of(engine, query)
        if name != "cpu":
            visits = ours.tracer.visits
            left[name] = counted(ours, n, answer)
            if name == "device, shafts":
                left[name]["visits"] = 16 * (ours.tracer.visits - visits) / n
        timings[name] = timed(answer, ours.rounds)
    if shafts:
        counters, single = new_counters(), Engine(ours.scene, "bsah+single", ours.threads)
        single.accelerator.answer(single.accelerated(), query, counters)
        left["device, host arrays"]["visits"] = 16 * int(counters[NODES]) / n
    for name, timing in timings.items():
        yield row(case, name, timing, n, timings["cpu"].answers) | left.get(name, {})


def shaft_cases(view: View, ours: Ours, options: argparse.Namespace) -> Iterator[tuple[str, ShadowQuery]]:
    """(name, query) of the shadow passes of the part `shafts`."""
    triangles = ours.scene.triangles()
    for name, light in view.lights.items():
        for spp in sorted({1, options.spp}):
            yield f"{name} {spp}", query_of(triangles, view.camera, light, spp, ours.threads)


def answer_of(engine: Engine, query: ShadowQuery) -> Callable[[], np.ndarray]:
    """A function that traces a query in the engine's tree."""
    ready = engine.accelerated()
    return lambda: engine.accelerator.answer(ready, query)


# --- Scenes -----------------------------------------------------------------------------------------------------------


def measure(view: View, options: argparse.Namespace, parts: list[str]) -> Iterator[dict[str, Any]]:
    """Rows of all cases of a scene in the parts `rays` and `shafts`."""
    vertices, frame = view.triangles.vertices.reshape(-1, 3, 3), view.triangles.origin
    world = vertices.astype(np.float64) + frame
    scene = antumbra.Scene.from_arrays(world)
    start = time.perf_counter()
    engine = Engine(scene, device=options.device, threads=options.threads)
    engine.accelerated()
    tracer = device_tracer(str(engine.plan.device))
    ours = Ours(scene, engine, tracer, thread_count(options.threads), options.rounds)
    print(
        f"\n{view.name}: {len(vertices)} triangles, built and uploaded in {time.perf_counter() - start:.2f} s\n{HEAD}"
    )
    triangles = scene.triangles()
    about = {"scene": view.name, "triangles": len(vertices)}
    if "shafts" in parts:
        for name, query in shaft_cases(view, ours, options):
            yield from pass_rows({**about, "case": name}, ours, query, True)
    if "rays" not in parts:
        return
    query = query_of(triangles, view.camera, view.lights["small"], options.spp, ours.threads)
    lists = {
        "coherent": coherent(query, triangles.origin, options.rays),
        "random": between_random_points(scene.bounds, options.rays),
        "hostile": hostile(world, scene.bounds, options.rays // 8),
    }
    for name, ends in lists.items():
        yield from segment_rows({**about, "case": name}, ours, ends)
    yield from closest_rows({**about, "case": "closest"}, ours, lists["random"])
    yield from pass_rows({**about, "case": "soft"}, ours, query, False)


def all_rows(options: argparse.Namespace) -> Iterator[dict[str, Any]]:
    """Rows of all parts that were asked for."""
    chosen = options.part or PARTS
    tracer = device_tracer(str(parse_plan(f"bsah+device:{options.device}").device))
    how = device_build.Timings(timed, row, options.rounds, thread_count(options.threads))
    for part, rows, head in (
        ("build", device_build.rows, HEAD.replace("Mrays", "    M")),
        ("frame", device_frame.rows, HEAD),
    ):
        for n in options.triangles if part in chosen else ():
            print(f"\n{part}, {n} triangles\n{head}")
            yield from rows(tracer, n, options, how)
    measures = device_surfaces.Measures(timed, row, options.rounds, thread_count(options.threads))
    for part in (each for each in device_surfaces.SCENES if each in chosen):
        for n in options.triangles:
            print(f"\n{part}, {n} triangles\n{HEAD}")
            yield from device_surfaces.rows(part, n, options, measures)
    if STORE in chosen:
        print(f"\n{STORE}\n{HEAD}")
        yield from device_store.rows(options, device_store.Measures(row, Timing, thread_count(options.threads)))
    if "rays" in chosen or "shafts" in chosen:
        for view in views(options.scene, options.size):
            yield from measure(view, options, chosen)


def file_of(device: Device) -> Path:
    """The file of results for a card."""
    words = re.sub(r"[^a-z0-9]+", "-", device.model.lower()).strip("-")
    return RESULTS / f"device-{words}.json"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("scene", nargs="*", help=f"{', '.join(VIEWS)}, or files; default: all of these")
    parser.add_argument("--device", required=True, help="cuda, cuda:1, opencl or host")
    parser.add_argument("--part", action="append", choices=[*PARTS, STORE], help=f"default: {', '.join(PARTS)}")
    parser.add_argument("--rays", type=int, default=1 << 23)
    parser.add_argument("--triangles", type=int, nargs="+", default=[10**6, 10**7], help="of builds")
    parser.add_argument("--size", type=int, nargs=2, default=(1024, 1024), metavar=("W", "H"))
    parser.add_argument("--spp", type=int, default=16)
    parser.add_argument("--store", type=Path, help="of the part store; default: a city that is removed afterwards")
    memory = partial(parse_bytes, what="--device-memory")
    parser.add_argument("--device-memory", type=memory, default=DEVICE_CHUNKS, help="for chunks; default: 8G")
    parser.add_argument("--frames", type=int, default=4, help="of each walk through a store")
    parser.add_argument("--kind", nargs="+", choices=device_store.KINDS, default=["shadow"], help="of rays in a store")
    parser.add_argument(
        "--walk", nargs="+", choices=device_store.WALKS, default=device_store.WALKS, help="default: both"
    )
    parser.add_argument("--threads", type=int, help="of the CPU; default: all cores")
    parser.add_argument("--rounds", type=int, default=7)
    parser.add_argument("--json", help="also write the rows to this file; auto: docs/results/device-NAME.json")
    options = parser.parse_args()
    device = device_tracer(str(parse_plan(f"bsah+device:{options.device}").device)).device
    path = None if options.json is None else file_of(device) if options.json == "auto" else Path(options.json)
    about = {**machine(thread_count(options.threads)), "device": device.model, "driver": device.driver}
    print(", ".join(f"{name} {value}" for name, value in about.items()), flush=True)
    rows: list[dict[str, Any]] = []
    for each in all_rows(options):
        rows.append(each)
        print(line(each) if "method" in each else step_line(each), flush=True)
        if "stages" in each:
            print(device_frame.stage_line(each), flush=True)
        if "paging" in each:
            print(device_store.chunk_line(each["paging"]), flush=True)
        if path is not None:  # after each row, because time on a card is short
            path.write_text(json.dumps({"machine": about, "rows": rows}, indent=1))
    if wrong := [each for each in rows if each.get("differs") and each["method"] != "warp"]:
        sys.exit(f"answers differ from the CPU's: {wrong}")


if __name__ == "__main__":
    try:
        main()
    except InputError as error:
        sys.exit(f"error: {error}")
