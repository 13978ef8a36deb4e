"""The tables of "Efficient ray traced soft shadows using multi-frusta tracing" [Benthin and Wald 2009], measured here.

    python benchmarks/multi_frusta.py [scene ...] [--size W H] [--rounds N] [--tables 1 2 6] [--json FILE]

Table 1: how much less multi-frusta tracing accesses and tests than packets of 16 rays, and how much faster it is; the
paper's own tracer (multifrusta:paper) and this package's (multifrusta), against packets over 16 pixels (packet16) and
over one pixel's samples (packet16:samples); 256 rays together (Sec. 5.2) beside them. Table 2: three ways of frustum
shrinking. Figure 6: lights from 1/4 to 8 times the edge.

A scene is a file that `antumbra.load` reads, with an info.json beside it for camera and light, or the name of a
procedural scene. Without one: Sponza and Robots from the folder of real scenes ($ANTUMBRA_SCENES, or ../shared/scenes
beside the repository) and the procedural forest. The light is a horizontal square whose edge is 1/40 of the scene's
diagonal.

Counts are of shadow rays only, 16 samples a pixel; the paper's include primary rays. Times are processor times of one
thread, of tracing alone, in turns; what a scene's tree costs is not in them. Kernels are compiled before.
"""

import json
import statistics
import time
from pathlib import Path
from typing import NamedTuple

import numpy as np

import antumbra
from antumbra.bvh import BUILDERS
from antumbra.query.picture import shadow_queries
from antumbra.query.sampling import light_samples
from antumbra.renderer import Renderer
from antumbra.scene.camera import Camera
from antumbra.scene.procedural import PROCEDURAL
from antumbra.trace import TRACERS
from antumbra.trace.counters import as_dict, new_counters
from common import SCENES, arguments, machine

SPP = 16
TABLE1 = ("packet16", "packet16:samples", "packet256", "multifrusta:paper", "multifrusta")
BASELINES = TABLE1[:2]
TABLE2 = ("multifrusta:paper", "multifrusta:leaf-boxes", "multifrusta:corners", "multifrusta:full")
FIGURE6 = ("multifrusta:paper", "multifrusta")
SIZES = (0.25, 0.5, 1.0, 2.0, 4.0, 8.0)
COLUMNS = ("triangles", "candidates", "box_tests", "triangle_tests")
PAPER1 = ("1.9-3.7", "5.0-10.1", "14.1-23.8", "1.0-1.4", "3.3-6.1")
PAPER2 = ("0 0 0 0", "-15 -19 +155 -26", "0 -14 0 -21", "-8 -18 -2 -23")


class Case(NamedTuple):
    """A scene with what is asked of it."""

    name: str
    triangles: object
    gbuffer: object
    prepared: dict  # tracer -> what it traces
    centre: np.ndarray  # (3,) of the light
    edges: tuple  # of the light, (3,) each


def case(path: str, size) -> Case:
    """Load a scene and prepare it for every tracer."""
    info = {}
    if path in PROCEDURAL:
        scene = antumbra.procedural(path)
        quad, name = scene.lights[0], path
        camera, centre = scene.cameras[0].resized(*size), quad.corner + 0.5 * (np.array(quad.u) + quad.v)
    else:
        file = Path(path)
        info, name = json.loads(file.with_name("info.json").read_text()), file.parent.name
        scene = antumbra.load(file, up="z" if info["up"][2] else "y")
        own, centre = info["camera"], np.array(info["light"])
        camera = Camera(own["position"], own["target"], info["up"], own["vfov"], *size)
    edge = np.linalg.norm(np.ptp(scene.bounds, axis=0)) / 40
    across = (0, edge, 0) if scene.up == "z" else (0, 0, edge)
    triangles = scene.triangles(0.0)
    gbuffer = Renderer(scene).see(triangles, camera, None)
    bvh = BUILDERS["bsah"].build(triangles.vertices)
    walking = {name: t for name, t in TRACERS.items() if t.builds}
    shared = {prepare: prepare(bvh) for prepare in {t.prepare for t in walking.values()}}
    prepared = {name: shared[t.prepare] for name, t in walking.items()}
    return Case(name, triangles, gbuffer, prepared, centre, (np.array((edge, 0, 0)), np.array(across)))


def query_of(case: Case, size: float = 1.0):
    """The query of a light whose edge is `size` times the usual one."""
    u, v = (size * np.asarray(e) for e in case.edges)
    light = antumbra.QuadLight(case.centre - 0.5 * (u + v), u, v)
    return shadow_queries(case.triangles, case.gbuffer, [light], [light_samples(light, SPP)])[0]


def answer(case: Case, tracer: str, query, counters=None) -> np.ndarray:
    bits = np.zeros((*query.sides.shape, 1), np.uint64)
    TRACERS[tracer].trace(case.prepared[tracer], query, bits, 1, counters, None)
    return bits


def measure(case: Case, tracers, query, rounds: int) -> dict[str, dict]:
    """Tracer -> its counters and median seconds; all must give the same bits."""
    results, seconds = {}, {t: [] for t in tracers}
    truth = answer(case, tracers[0], query)
    for tracer in tracers:
        counters = new_counters()
        if not np.array_equal(answer(case, tracer, query, counters), truth):
            raise SystemExit(f"{case.name}: {tracer} and {tracers[0]} give different bits")
        results[tracer] = as_dict(counters)
        answer(case, tracer, query)  # compiles
    for _ in range(rounds):
        for tracer in tracers:
            start = time.thread_time()
            answer(case, tracer, query)
            seconds[tracer].append(time.thread_time() - start)
    for tracer, s in seconds.items():
        if s:
            results[tracer]["seconds"] = statistics.median(s)
    return results


def thousands(result: dict) -> str:
    return " ".join(f"{result[c] / 1e3:10.0f}K" for c in COLUMNS)


def table1(case: Case, rounds: int) -> dict:
    results = measure(case, TABLE1, query_of(case), rounds)
    rays = next(iter(results.values()))["rays"]
    print(f"\nTable 1, {case.name}: {len(case.triangles.vertices)} triangles, {rays / 1e6:.2f}M rays")
    print(f"{'':24s} {'#tris':>11s} {'+culling':>11s} {'#AABB':>11s} {'#isec':>11s} {'seconds':>8s} {'Mrays/s':>8s}")
    for tracer, r in results.items():
        print(f"{tracer:24s} {thousands(r)} {r['seconds']:8.3f} {rays / r['seconds'] / 1e6:8.2f}")
    for base in BASELINES:
        print(f"times less than {base}; in the paper {', '.join(PAPER1)}")
        for tracer in TABLE1[2:]:
            less = " ".join(f"{results[base][c] / max(results[tracer][c], 1):10.2f}x" for c in COLUMNS)
            print(f"{tracer:24s} {less} {results[base]['seconds'] / results[tracer]['seconds']:7.2f}x")
    return results


def table2(case: Case, rounds: int) -> dict:
    results = measure(case, TABLE2, query_of(case), rounds)
    none = results[TABLE2[0]]
    print(f"\nTable 2, {case.name}: change in % of #tris, +culling, #AABB, #isec; in the paper (T-Rex) in brackets")
    for tracer, paper in zip(TABLE2, PAPER2, strict=True):
        r = results[tracer]
        change = " ".join(f"{100 * (r[c] / max(none[c], 1) - 1):+8.1f}" for c in COLUMNS)
        more = f"{r['shrinks'] / 1e3:8.0f}K shrinks, {none['seconds'] / r['seconds']:5.2f}x as fast"
        print(f"{tracer:24s} {change} [{paper:18s}] {more}")
    return results


def figure6(case: Case) -> dict:
    print(f"\nFigure 6, {case.name}: #tris and #isec, in thousands, by the light's edge")
    print(f"{'':24s} " + " ".join(f"{s:>16g}" for s in SIZES))
    results = {s: measure(case, FIGURE6, query_of(case, s), 0) for s in SIZES}
    for tracer in FIGURE6:
        pairs = [(results[s][tracer]["triangles"] / 1e3, results[s][tracer]["triangle_tests"] / 1e3) for s in SIZES]
        print(f"{tracer:24s} " + " ".join(f"{f'{a:.0f} {b:.0f}':>16s}" for a, b in pairs), flush=True)
    return {str(s): r for s, r in results.items()}


def main() -> None:
    parser = arguments(__doc__)
    parser.set_defaults(rounds=5)
    parser.add_argument("--size", type=int, nargs=2, default=(512, 512), metavar=("W", "H"))
    parser.add_argument("--tables", type=int, nargs="+", default=[1, 2, 6], choices=[1, 2, 6])
    options = parser.parse_args()
    real = [str(p) for n in ("sponza_crytek", "bart_robots") if (p := SCENES / n / "scene.glb").exists()]
    rows = {}
    for path in [str(p) for p in options.scene] or [*real, "forest"]:
        one = case(path, options.size)
        rows[one.name] = {
            **({"table 1": table1(one, options.rounds)} if 1 in options.tables else {}),
            **({"table 2": table2(one, options.rounds)} if 2 in options.tables else {}),
            **({"figure 6": figure6(one)} if 6 in options.tables else {}),
        }
    if options.json:
        options.json.write_text(json.dumps({"machine": machine(1), "size": options.size, "rows": rows}, indent=1))


if __name__ == "__main__":
    main()
