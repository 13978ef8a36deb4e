"""A server that answers small queries: latency, scaling over threads and processes, and growth of memory.

    python benchmarks/server.py [SCENE] [--rounds N] [--calls N] [--threads N] [--json FILE]

`Scene.occluded`, embreex and Open3D trace segments between random points in the scene's bounds, from NumPy arrays to
NumPy arrays, on one thread per call. The default scene is procedural, with 100,000 triangles, and its trees are built
beforehand.

- Latency: each round calls every library in turn. Rows have the median and the 99th percentile of all calls.
- Scaling: as many Python threads as named call one scene for a while; then as many processes, forked after the trees
  were built. Rows have the calls per second of all together, a median over the rounds, relative to one alone.
- Memory: how much the process grows over --calls calls of each kind.
"""

import gc
import json
import multiprocessing
import os
import sys
import threading
import time
from collections.abc import Callable
from pathlib import Path
from statistics import median
from typing import Any

import numpy as np

import antumbra as at
from antumbra.engine.auto.cost_model import best_pays
from antumbra.engine.sources.in_memory_source import RAY_PLANS
from antumbra.kernels.parallel import thread_count
from common import arguments, has_embree, installed, machine
from peers import open3d_rays

SIZES = 1, 100, 10_000
"""Rays per call."""

_SECONDS = 0.2  # time per library, size and round
_WARM_UP = 10_000  # calls before memory is measured, within which the scene builds its best trees

Call = Callable[[np.ndarray, np.ndarray], np.ndarray]
"""A function of (n, 3) float32 origins and directions that returns (n,) bool: which segments are occluded."""


def main() -> int:
    parser = arguments(__doc__)
    parser.set_defaults(rounds=5, threads=max(8, thread_count(None)))
    parser.add_argument("--calls", type=int, default=100_000, help="calls of each kind while memory is measured")
    options = parser.parse_args()
    workers = thread_count(options.threads)  # at most so many
    scene = at.load(options.scene[0]) if options.scene else at.procedural("city", triangles=100_000)
    libraries = libraries_of(scene)
    rows = [*latencies(libraries, scene, options.rounds)]
    counts = [n for n in (1, 2, 4, 8, 16, 32, 64) if n < workers] + [workers]
    rows += scaling(libraries, scene, counts, options.rounds)
    rows += growth(scene, options.calls)
    for row in rows:
        print(line(row))
    if options.json is not None:
        about = {"machine": machine(workers), "scene": scene.name, "triangles": scene.n_triangles}
        options.json.write_text(json.dumps({**about, "rows": rows}, indent=1) + "\n")
    return 0


def line(row: dict[str, Any]) -> str:
    """A row of the table."""
    return "  ".join(
        f"{name} {value:,.4g}" if isinstance(value, float) else f"{name} {value}" for name, value in row.items()
    )


# --- Libraries --------------------------------------------------------------------------------------------------------


def libraries_of(scene) -> dict[str, Call]:
    """Name -> call, on one thread. All answers are compared once."""
    libraries: dict[str, Call] = {"antumbra": lambda o, d: scene.occluded(o, d, tmax=1.0, threads=1)}
    if has_embree():
        libraries["embreex"] = _embreex(scene)
    if installed(open3d_rays.library):
        libraries["open3d"] = _open3d(scene)
    rays = segments(scene, 10_000)
    while best_pays(np.inf, scene.n_triangles) and str(scene.engine.source.ray_lists.plan) != RAY_PLANS[1]:
        scene.occluded(*rays, tmax=1.0)  # until the scene has optimised its tree
    answers = {name: call(*rays) for name, call in libraries.items()}
    for name, answer in answers.items():
        if (answer != answers["antumbra"]).mean() > 0.001:
            raise SystemExit(f"{name} was given other rays: {(answer != answers['antumbra']).mean():.1%} differ")
    return libraries


def _embreex(scene) -> Call:
    from embreex import rtcore_scene
    from embreex.mesh_construction import TriangleMesh

    built = rtcore_scene.EmbreeScene()
    mesh = TriangleMesh(built, (scene.triangles().vertices + scene.origin).astype(np.float32))

    def call(origins, directions, mesh=mesh):
        return built.run(origins, directions, query="OCCLUDED", dists=1.0) >= 0

    return call


def _open3d(scene) -> Call:
    open3d = open3d_rays.library()
    built = open3d.t.geometry.RaycastingScene(nthreads=1)
    vertices = (scene.triangles().vertices + scene.origin).astype(np.float32).reshape(-1, 3)
    built.add_triangles(vertices, np.arange(len(vertices), dtype=np.uint32).reshape(-1, 3))

    def call(origins, directions):
        six = open3d.core.Tensor(np.concatenate([origins, directions], 1))
        return built.test_occlusions(six, tfar=1.0, nthreads=1).numpy()

    return call


def segments(scene, n: int, seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
    """Origins and directions, (n, 3) float32, of segments between random points in the bounds."""
    a, b = np.random.default_rng(seed).uniform(*scene.bounds, (2, n, 3)).astype(np.float32)
    return a, b - a


# --- Latency ----------------------------------------------------------------------------------------------------------


def latencies(libraries: dict[str, Call], scene, rounds: int) -> list[dict[str, Any]]:
    """A row per library and number of rays, with microseconds per call."""
    rows = []
    for n in SIZES:
        rays = segments(scene, n)
        times: dict[str, list[float]] = {name: [] for name in libraries}
        for _ in range(rounds):
            for name, call in libraries.items():
                times[name] += _times(call, rays)
        for name, each in times.items():
            middle, late = np.percentile(each, (50, 99))
            row = {"part": "latency", "rays": n, "library": name, "median_us": 1e6 * middle, "p99_us": 1e6 * late}
            rows.append({**row, "calls": len(each)})
    return rows


def _times(call: Call, rays: tuple[np.ndarray, np.ndarray]) -> list[float]:
    """Seconds of single calls, for `_SECONDS`; the first call is not among them."""
    call(*rays)
    times, end = [], time.perf_counter() + _SECONDS
    while True:
        start = time.perf_counter()
        call(*rays)
        stop = time.perf_counter()
        times.append(stop - start)
        if stop > end:
            return times


# --- Scaling ----------------------------------------------------------------------------------------------------------


def scaling(libraries: dict[str, Call], scene, counts: list[int], rounds: int) -> list[dict[str, Any]]:
    """A row per library, kind and number of workers, and number of rays."""
    kinds = {"threads": by_threads} | ({"processes": by_processes} if hasattr(os, "fork") else {})
    rows = []
    for n in SIZES:
        rates: dict[tuple[str, str, int], list[float]] = {}
        for _ in range(rounds):
            for name, call in libraries.items():
                for kind, run in kinds.items():
                    for count in counts if kind == "threads" or name == "antumbra" else ():
                        rates.setdefault((name, kind, count), []).append(run(call, segments(scene, n), count))
        alone = {key[:2]: median(all_) for key, all_ in rates.items() if key[2] == 1}
        for (name, kind, count), all_ in rates.items():
            row = {"part": "scaling", "rays": n, "library": name, "workers": kind, "count": count}
            rows.append({**row, "calls_per_second": median(all_), "speedup": median(all_) / alone[name, kind]})
    return rows


def by_threads(call: Call, rays: tuple[np.ndarray, np.ndarray], count: int) -> float:
    """Calls per second of `count` Python threads together."""
    barrier, made = threading.Barrier(count), [0.0] * count

    def work(k: int) -> None:
        made[k] = _rate(call, rays, barrier.wait)

    threads = [threading.Thread(target=work, args=(k,)) for k in range(count)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    return sum(made)


def by_processes(call: Call, rays: tuple[np.ndarray, np.ndarray], count: int) -> float:
    """Calls per second of `count` forked processes together."""
    fork = multiprocessing.get_context("fork")
    barrier, rates = fork.Barrier(count), fork.SimpleQueue()
    children = [fork.Process(target=lambda: rates.put(_rate(call, rays, barrier.wait))) for _ in range(count)]
    for child in children:
        child.start()
    total = sum(rates.get() for _ in children)
    for child in children:
        child.join()
    return total


def _rate(call: Call, rays: tuple[np.ndarray, np.ndarray], wait: Callable[[], object]) -> float:
    """Calls per second of this thread, once all are there."""
    call(*rays)
    wait()
    start, n = time.perf_counter(), 0
    while time.perf_counter() - start < _SECONDS:
        call(*rays)
        n += 1
    return n / (time.perf_counter() - start)


# --- Memory -----------------------------------------------------------------------------------------------------------


def growth(scene, calls: int) -> list[dict[str, Any]]:
    """A row per kind of query: bytes by which the process grows over many calls, and per call."""
    light, (origins, directions) = at.PointLight(scene.bounds.mean(0)), segments(scene, 64)
    queries: dict[str, Callable[[int], object]] = {
        "occluded": lambda k: scene.occluded(origins[k % 64], directions[k % 64]),
        "closest_hit": lambda k: scene.closest_hit(origins[k % 64], directions[k % 64]).position,
        "visibility": lambda k: at.visibility(scene, origins[k % 64], light),
    }
    rows = []
    for name, query in queries.items():
        before = 0
        for k in range(-min(_WARM_UP, calls), calls):
            if k == 0:
                gc.collect()
                before = resident()
            query(k)
        gc.collect()
        grown = resident() - before
        rows.append({"part": "memory", "query": name, "calls": calls, "grown_bytes": grown, "per_call": grown / calls})
    return rows


def resident() -> int:
    """Resident bytes of this process."""
    return int(Path("/proc/self/statm").read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE")


if __name__ == "__main__":
    sys.exit(main())
