"""Small queries: the cost of a call, compared with trimesh with Embree.

    python benchmarks/small.py [SCENE ...] [--rounds N] [--threads N] [--json FILE]

Each round runs every query in turn, in samples of a few calls, of which the fastest counts: other processes interrupt
the others. The table has the median over the rounds, in microseconds per call, and its ratio to a single-ray query of
trimesh. The default scene is procedural, with 20,000 triangles.
"""

import json
import sys
from collections.abc import Callable
from statistics import median
from time import perf_counter

import numpy as np

import antumbra as at
from antumbra.kernels.parallel import thread_count
from common import arguments, installed, machine

_SECONDS = 0.03  # approximate time per query and round
_CALLS = 10  # per sample
_RAYS = 100, 10_000


def main() -> int:
    parser = arguments(__doc__)
    options = parser.parse_args()
    threads = thread_count(options.threads)
    scenes = [at.load(path) for path in options.scene] or [at.procedural("atrium", triangles=20_000)]
    rows = [row for scene in scenes for row in rows_of(scene, threads, options.rounds)]
    if options.json is not None:
        options.json.write_text(json.dumps({"machine": machine(threads), "rows": rows}, indent=1) + "\n")
    return 0


def rows_of(scene, threads: int, rounds: int) -> list[dict]:
    """Print and return the table of a scene."""
    calls = queries(scene, threads)
    times: dict[str, list[float]] = {name: [] for name in calls}
    for _ in range(rounds):
        for name, call in calls.items():
            times[name].append(seconds(call))
    medians = {name: 1e6 * median(all_) for name, all_ in times.items()}
    peer = next((value for name, value in medians.items() if name.startswith("trimesh")), None)
    print(f"{scene.name}, {scene.n_triangles:,} triangles, {threads} threads")
    rows = []
    for name, value in medians.items():
        ratio = None if peer is None else value / peer
        print(f"  {name:34}{value:10.1f} us" + ("" if ratio is None else f"{ratio:8.2f} x"))
        rows.append({"scene": scene.name, "query": name, "microseconds": value, "ratio": ratio})
    return rows


def queries(scene, threads: int) -> dict[str, Callable[[], object]]:
    """Name -> call."""
    rng = np.random.default_rng(1)
    low, high = scene.bounds
    rays = {n: (rng.uniform(low, high, (n, 3)), rng.normal(size=(n, 3))) for n in (1, *_RAYS)}
    light, point = at.PointLight((low + high) / 2), rays[1][0]
    calls: dict[str, Callable[[], object]] = {
        "occluded, 1 ray": lambda: scene.occluded(*rays[1]),
        "closest_hit, 1 ray": lambda: scene.closest_hit(*rays[1]),
        "occluded, 100 rays": lambda: scene.occluded(*rays[100]),
        f"occluded, 10,000 rays, {threads} threads": lambda: scene.occluded(*rays[10_000], threads=threads),
        "visibility, 1 point, 1 point light": lambda: at.visibility(scene, point, light),
    }
    if installed(_trimesh):
        intersector = _trimesh()(scene)
        for n in (1, *_RAYS):
            calls[f"trimesh with Embree, {n:,} ray{'s' * (n > 1)}"] = lambda n=n: intersector.intersects_any(*rays[n])
    return calls


def seconds(call: Callable[[], object]) -> float:
    """The mean time of a call in the fastest sample."""
    call()
    begin, fastest = perf_counter(), float("inf")
    while (start := perf_counter()) < begin + _SECONDS:
        for _ in range(_CALLS):
            call()
        fastest = min(fastest, (perf_counter() - start) / _CALLS)
    return fastest


def _trimesh() -> Callable:
    """A function that makes a scene's trimesh intersector, which uses Embree."""
    try:
        import trimesh
        from trimesh.ray.ray_pyembree import RayMeshIntersector
    except ImportError as error:
        raise at.InputError(f"trimesh with Embree ({error}); pip install trimesh embreex") from None

    def intersector(scene):
        soup = scene.triangles().vertices.reshape(-1, 3) + scene.origin
        mesh = trimesh.Trimesh(soup, np.arange(len(soup)).reshape(-1, 3), process=False)
        return RayMeshIntersector(mesh)

    return intersector


if __name__ == "__main__":
    sys.exit(main())
