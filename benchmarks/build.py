"""BVH build times: every builder of Antumbra and Embree's three, alternating in one process.

    python benchmarks/build.py [scene ...] [--hills N ...] [--threads N] [--rounds N] [--size N] [--json FILE]

A scene is a file that `antumbra.load` reads. --hills adds generated hills of about N triangles. The default scenes are
Sponza and San Miguel from $ANTUMBRA_SCENES, or from ../shared/scenes beside the repository, else hills.

Timed for Antumbra: from the (n, 3, 3) float32 vertices to the finished Bvh, with compiled kernels. Timed for Embree:
`rtcCommitScene`, with the same triangles and threads and filled buffers.

Each tree is validated, and traced by two tracers with 16 shadow rays to the default light per pixel of the default
camera (512 x 512 or N x N).
"""

import json
import random
import statistics
import time
from contextlib import nullcontext
from pathlib import Path

import numpy as np

import antumbra
from antumbra.bvh.tree_quality import sah_cost, validate
from antumbra.bvh.tree_quality import statistics as shape_of
from antumbra.engine.method_registry import BUILDERS, TRACERS
from antumbra.kernels.parallel import thread_count
from antumbra.picture.renderer import Renderer
from antumbra.query.light_samples import light_samples
from antumbra.query.shadow_query import shadow_queries
from common import SCENES, arguments, has_embree, machine
from peers.embree import QUALITIES, Device, EmbreeScene

PEER = "embree medium"  # ratios are relative to this method
TRACED_BY = ("single", "multifrusta")
PAUSE = 0.05  # seconds to wait after each Embree build, because its threads spin for a while
REAL = ("sponza_crytek", "sanmiguel_lite")


def hills(n: int = 262_144) -> np.ndarray:
    """(m, 3, 3) float32: a bumpy surface of about n triangles."""
    side = round((n / 2) ** 0.5)
    x, y = np.meshgrid(np.linspace(0, 100, side + 1), np.linspace(0, 100, side + 1))
    noise = np.random.default_rng(0).normal(0, 0.02, x.shape)
    p = np.stack([x, np.sin(x / 3) * np.cos(y / 5) * 4 + noise, y], -1).astype(np.float32)
    a, b, c, d = p[:-1, :-1], p[:-1, 1:], p[1:, :-1], p[1:, 1:]
    return np.concatenate([np.stack([a, b, d], 2).reshape(-1, 3, 3), np.stack([a, d, c], 2).reshape(-1, 3, 3)])


def scenes(paths: list[Path], sizes: list[int]):
    """Yield (name, vertices) of each scene."""
    for n in sizes:
        yield f"hills {n}", hills(n)
    if sizes and not paths:
        return
    paths = paths or [p for name in REAL if (p := SCENES / name / "scene.glb").exists()]
    if not paths:
        print(f"no scene given and none in {SCENES}: using generated hills")
        yield "hills", hills()
    for path in paths:
        yield path.parent.name if path.stem == "scene" else path.stem, antumbra.load(path).triangles(0.0).vertices


def timed(build) -> float:
    start = time.perf_counter()
    result = build()
    seconds = time.perf_counter() - start
    del result  # not timed, as with Embree
    return seconds


def embree_seconds(device: Device, vertices, quality: str) -> float:
    with EmbreeScene(device, vertices, quality=quality) as scene:
        seconds = scene.build_seconds
    time.sleep(PAUSE)
    return seconds


def query_of_trees(vertices, threads: int, size: int):
    """The shadow query for tracing the trees."""
    scene = antumbra.Scene.from_arrays(vertices)
    renderer, triangles, light = Renderer(scene, threads=threads), scene.triangles(0.0), scene.default_light()
    gbuffer = renderer.see(triangles, scene.default_camera(size, size), None)
    return shadow_queries(triangles, gbuffer, [light], [light_samples(light, 16)], threads=threads)[0]


def trace_ms(bvh, tracer, query, threads: int) -> float:
    """Milliseconds to trace a query: the fastest of three runs, without the tracer's preparation."""
    prepared = tracer.prepare(bvh, threads)
    bits = np.zeros((*query.sides.shape, 1), np.uint64)
    return 1e3 * min(timed(lambda: tracer.trace(prepared, query, bits, threads, None, None)) for _ in range(3))


def describe(build, vertices, query, threads: int) -> dict:
    """Quality measures of a tree; also compiles the kernels and validates the tree."""
    bvh = build()
    validate(bvh, vertices)
    shape = shape_of(bvh)
    facts = {"sah": sah_cost(bvh), "bytes_per_triangle": shape.bytes_per_triangle, "depth": shape.depth}
    return facts | {f"trace_{name}_ms": trace_ms(bvh, TRACERS[name], query, threads) for name in TRACED_BY}


def measure(name: str, vertices, threads: int, rounds: int, size: int) -> list[dict]:
    """A row per method."""
    ours = {k: lambda b=b: b.build(vertices, threads) for k, b in BUILDERS.items()}
    query = query_of_trees(vertices, threads, size)
    facts = {k: describe(build, vertices, query, threads) for k, build in ours.items()}
    qualities = QUALITIES if has_embree() else ()
    seconds = {k: [] for k in (*ours, *(f"embree {q}" for q in qualities))}
    with Device(threads) if qualities else nullcontext() as device:
        runs = {k: lambda build=build: timed(build) for k, build in ours.items()}
        runs |= {f"embree {q}": lambda q=q: embree_seconds(device, vertices, q) for q in qualities}
        shuffled = random.Random(0)
        for _ in range(rounds):
            for k in shuffled.sample(list(runs), len(runs)):  # what runs after a long build takes longer
                seconds[k].append(runs[k]())
    peer = seconds.get(PEER)
    return [
        {
            "scene": name,
            "triangles": len(vertices),
            "method": k,
            "median_ms": 1e3 * statistics.median(s),
            "min_ms": 1e3 * min(s),
            "max_ms": 1e3 * max(s),
            "ratio": statistics.median(s) / statistics.median(peer) if peer else None,
            "ratio_of_minima": min(s) / min(peer) if peer else None,
            **facts.get(k, {}),
        }
        for k, s in seconds.items()
    ]


def line(row: dict) -> str:
    quality = ""
    if "sah" in row:
        traced = " ".join(f"{row[f'trace_{name}_ms']:11.1f}" for name in TRACED_BY)
        quality = f"{row['sah']:8.2f} {row['bytes_per_triangle']:8.1f} {row['depth']:6d} {traced}"
    times = f"{row['median_ms']:9.1f} {row['min_ms']:8.1f} {row['max_ms']:8.1f}"
    ratios = " ".join(" " * 7 if row[k] is None else f"{row[k]:7.2f}" for k in ("ratio", "ratio_of_minima"))
    return f"{row['scene']:20s} {row['method']:15s} {times} {ratios} {quality}"


def main() -> None:
    parser = arguments(__doc__)
    parser.add_argument("--hills", type=int, nargs="+", default=[], metavar="N")
    parser.add_argument(
        "--size", type=int, default=512, metavar="N", help="width and height of the traced picture in pixels"
    )
    options = parser.parse_args()
    threads = thread_count(options.threads)
    print(
        f"{'scene':20s} {'method':15s} {'median ms':>9s} {'min':>8s} {'max':>8s} "
        f"{'ratio':>7s} {'of mins':>7s} {'SAH':>8s} {'B/tri':>8s} {'depth':>6s} "
        + " ".join(f"{name:>11s}" for name in TRACED_BY)
    )
    rows = []
    for name, vertices in scenes(options.scene, options.hills):
        for row in measure(name, vertices, threads, options.rounds, options.size):
            rows.append(row)
            print(line(row), flush=True)
    if options.json:
        options.json.write_text(json.dumps({"machine": machine(threads), "rows": rows}, indent=1))


if __name__ == "__main__":
    main()
