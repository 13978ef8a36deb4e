"""Soft shadows: our tracers, Embree, Mitsuba 3 and Open3D, alternating in one process on the same rays.

    python benchmarks/soft_shadows.py [scene ...] [--plans PLAN ...] [--threads N ...] [--rounds N] [--isa avx2]

A scene is sponza_crytek, sanmiguel_lite, bart_robots ($ANTUMBRA_SCENES), forest (procedural), or a file that
`antumbra.load` reads. Each has a small and a large square light. The small light's edge is 1/40 of the scene's diagonal
(`lab.papers.benchmark_views` has the exception), or that of the forest's own light. The large light's edge is four
times as long.

Timed for ours: from a ShadowQuery to its bits, as when rendering a frame, including allocation of the bits.

Timed for the peers: tracing rays generated beforehand, in Morton order of 4 x 4 pixel blocks, singly or in packets. A
packet is one light sample of 16 pixels, or 16 samples of one pixel; on AVX2 it has 8 rays, because Embree traces
packets of 16 ray by ray there. Answers stay where the peer wrote them. Reading rays from memory costs Embree about 6 %.
Its time does not include generating rays; ours does.

Peers get only rays above their receiver's horizon, and only these count in Mrays/s for all contenders. Builds are timed
separately.

Every mode of every peer is tried once. Then ours and the best modes of each peer are timed alternately. The ratio
compares the median rates, ours over the fastest peer's. `differs` counts the rays whose answers differ from our first
plan's (peers are subject to rounding; ours are exact).
"""

import argparse
import time

import numpy as np

from antumbra.engine.method_registry import BUILDERS, OPTIMISERS, TRACERS
from antumbra.engine.plan import Plan, parse_plan
from antumbra.engine.plan_records import precompile_plan
from antumbra.kernels.parallel import thread_count
from antumbra.techniques.culling.pre_bvh_culling import soup_of
from comparison import HEAD, compare, line, options_of, progress, start
from peers.contenders import embree_contenders, embree_scenes, other_peers, our_contender
from peers.ray_contest import ORDERS, contest, query_of, rows, shadow_rays

QUALITY = "bsah"


def our_scenes(plans: list[Plan], triangles) -> dict[Plan, object]:
    """Plan -> its tracer's acceleration structure. Prints the times to build and prepare it."""
    prepared, trees = {}, {}
    for plan in plans:
        build = plan.build or (QUALITY if plan.tracer.builds else None)  # the plan auto would choose among three
        how = (build, plan.optimise)
        start = time.perf_counter()
        if how not in trees:
            trees[how] = BUILDERS[build].build(triangles.vertices, None) if build else soup_of(triangles)
            if plan.optimise:
                trees[how] = OPTIMISERS[plan.optimise].optimise(trees[how], None)
            name = "+".join(filter(None, how)) or "triangles"
            print(f"  {name}: built in {1e3 * (time.perf_counter() - start):.0f} ms", end="")
            start = time.perf_counter()
        prepared[plan] = plan.tracer.prepare(trees[how], thread_count(None))
        print(f"; {plan.trace}: prepared in {1e3 * (time.perf_counter() - start):.0f} ms")
    return prepared


def measure_light(view, size, prepared, built, others, options) -> list[dict]:
    """Rows for one light, "small" or "large", and all thread counts."""
    light = view.lights[size]
    query = query_of(view.triangles, view.camera, light, options.spp, thread_count(None))
    rays = shadow_rays(query)
    n, edge, table = int(rays.active.sum()), float(np.linalg.norm(light.u)), []
    for threads in options.threads:
        contenders = [our_contender(plan, scene, query, threads) for plan, scene in prepared.items()]
        contenders += embree_contenders(built, rays, ORDERS, False, threads)
        contenders += [c for make, scene in others for c in make(scene, rays, threads)]
        results, blocked = contest(contenders, rays.active, options.rounds, options.clock, progress)
        progress("")
        case = {"scene": view.name, "triangles": len(view.triangles.vertices), "light": size, "edge": edge}
        case |= {"threads": threads, "clock": options.clock, "occluded": float(blocked.mean())}
        rays_text = f"{n / 1e6:.2f} Mrays, {blocked.mean():.1%} occluded"
        print(f"\n{view.name}, {size} light (edge {edge:.3g}), {rays_text}, {threads} thread(s)\n{HEAD}")
        table += rows(case, results, n)
        print("\n".join(line(row) for row in table[-len(results) :]), flush=True)
    return table


def measure(view, options) -> list[dict]:
    """Rows for both lights and all thread counts."""
    vertices = view.triangles.vertices
    print(f"\n{view.name}: {len(vertices)} triangles")
    prepared = our_scenes(options.plans, view.triangles)
    with embree_scenes(vertices, options.isa) as built:
        others = [] if options.isa else other_peers(vertices)  # their instruction set cannot be chosen
        times = [
            f"Embree {q}{' robust' * bool(f)} {1e3 * s.build_seconds:.0f} ms" for (q, f), s in built.scenes.items()
        ]
        times += [f"{type(s).__name__} {1e3 * s.build_seconds:.0f} ms" for _, s in others]
        print(f"  built in: {', '.join(times)}")
        return [row for size in options.lights for row in measure_light(view, size, prepared, built, others, options)]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--plans", nargs="+", default=[Plan(trace=t) for t in TRACERS], help="default: every tracer")
    parser.add_argument("--lights", nargs="+", choices=("small", "large"), default=("small", "large"))
    parser.add_argument("--spp", type=int, default=16)
    options = options_of(parser)
    options.plans = [parse_plan(plan) for plan in options.plans]
    for plan in options.plans:
        precompile_plan(plan, "raster", False)
    compare(options, measure)


if __name__ == "__main__":
    start(main)
