"""Soft shadows: our tracers beside Embree, Mitsuba 3 and Open3D, in one process, turn by turn, on the same rays.

    python benchmarks/soft_shadows.py [scene ...] [--plans PLAN ...] [--threads N ...] [--rounds N] [--isa avx2]

A scene is sponza_crytek, sanmiguel_lite, bart_robots ($ANTUMBRA_SCENES), forest (procedural), or a file that
`antumbra.load` reads. Each has a small and a large square light. The small light's edge is 1/40 of the scene's diagonal
(`antumbra.papers.benchmark_views` has the exception), or that of the forest's own light. The large light's edge is four
times as long.

Timed for ours: from a ShadowQuery to its bits, as a frame is rendered, with making the array of bits.

Timed for the peers: tracing rays that were made before. Rays are in Morton order of 4 x 4 pixels, one by one or in
packets. A packet is one light sample of 16 pixels, or 16 samples of one pixel. On AVX2 a packet has 8 rays, because
Embree traces 16 ray by ray there. Answers stay where the peer wrote them. Reading rays from memory costs Embree about
6 %. Making rays costs it nothing here; ours makes its own.

Peers get only rays above their receiver's horizon, and for all contenders only these count in Mrays/s. Builds are timed
separately.

Every mode of every peer is tried once. Then ours and the best modes of each peer are timed in turns. The ratio is the
ratio of the medians, ours to the fastest peer's. `differs` counts the rays whose answers differ from our first plan's
(peers round; ours do not).
"""

import argparse
import time

import numpy as np

from antumbra.engine.method_registry import BUILDERS, OPTIMISERS, TRACERS
from antumbra.engine.plan import Plan, parse_plan
from antumbra.kernels.parallel import thread_count
from antumbra.papers.peers.peer_measurements import embree_contenders, our_contender
from antumbra.papers.peers.ray_contest import ORDERS, contest, query_of, rows, shadow_rays
from antumbra.picture.render_kernels import precompile_plan
from antumbra.techniques.culling.pre_bvh_culling import soup_of
from comparison import HEAD, compare, line, options_of, progress, start
from peer_contenders import embree_scenes, other_peers

QUALITY = "bsah"


def our_scenes(plans: list[Plan], triangles) -> dict[Plan, object]:
    """Plan -> the acceleration structure of its tracer. Prints the times to build and prepare it."""
    made, trees = {}, {}
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
        made[plan] = plan.tracer.prepare(trees[how], thread_count(None))
        print(f"; {plan.trace}: prepared in {1e3 * (time.perf_counter() - start):.0f} ms")
    return made


def measure_light(view, size, prepared, built, others, options) -> list[dict]:
    """Rows of one light, "small" or "large", for all numbers of threads."""
    light = view.lights[size]
    query = query_of(view.triangles, view.camera, light, options.spp, thread_count(None))
    rays = shadow_rays(query)
    n, edge, found = int(rays.asked.sum()), float(np.linalg.norm(light.u)), []
    for threads in options.threads:
        contenders = [our_contender(plan, scene, query, threads) for plan, scene in prepared.items()]
        contenders += embree_contenders(built, rays, ORDERS, False, threads)
        contenders += [c for make, scene in others for c in make(scene, rays, threads)]
        results, blocked = contest(contenders, rays.asked, options.rounds, options.clock, progress)
        progress("")
        case = {"scene": view.name, "triangles": len(view.triangles.vertices), "light": size, "edge": edge}
        case |= {"threads": threads, "clock": options.clock, "occluded": float(blocked.mean())}
        told = f"{n / 1e6:.2f} Mrays, {blocked.mean():.1%} occluded"
        print(f"\n{view.name}, {size} light (edge {edge:.3g}), {told}, {threads} thread(s)\n{HEAD}")
        found += rows(case, results, n)
        print("\n".join(line(row) for row in found[-len(results) :]), flush=True)
    return found


def measure(view, options) -> list[dict]:
    """Rows of both lights and all numbers of threads."""
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
