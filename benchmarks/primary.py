"""Primary visibility: our rasteriser, our rays and Embree, alternating in one process on the same pixels.

    python benchmarks/primary.py [scene ...] [--size W H] [--threads N ...] [--rounds N] [--isa avx2] [--json FILE]

A scene is sponza_crytek, sanmiguel_lite, bart_robots ($ANTUMBRA_SCENES), forest (procedural), or a file that
`antumbra.load` reads.

Timed for ours:

- `rays`: from the `BlockTree` to face and t of each pixel. The tree is built beforehand, like the peers' trees.
- `rasterise`: from the triangles to face and t of each pixel, without a BVH.
- `gbuffer`: `rasterise`, then positions and normals.

Timed for Embree: rtcIntersect1 and rtcIntersect16 (8 on AVX2) on rays generated beforehand, in Morton order of 4 x 4
pixel blocks, each of which is a packet. Answers stay in the records. Ratios are as in `soft_shadows`.
"""

import argparse

from antumbra.bvh.block_tree import block_tree
from antumbra.engine.method_registry import BUILDERS
from antumbra.engine.plan import Plan
from antumbra.engine.plan_records import precompile_plan
from antumbra.query.gbuffer import from_hits
from antumbra.query.rasteriser import RASTER_COUNTERS, new_raster_counters, rasterise
from antumbra.trace.primary.primary_rays import trace_primary
from comparison import HEAD, compare, line, options_of, progress, start
from peers.contenders import embree_contenders, embree_scenes
from peers.ray_contest import OURS, Contender, contest, primary_rays, rows

BUILDER = "bsah"


def our_contenders(tree, triangles, rays, threads: int) -> list[Contender]:
    corners = triangles.vertices.reshape(-1, 9)
    queries = {
        "rays": (lambda: trace_primary(tree, rays, threads), lambda hits: hits[0]),
        "rasterise": (lambda: rasterise(corners, rays, threads), lambda hits: hits[0]),
        "gbuffer": (
            lambda: from_hits(*rasterise(corners, rays, threads), triangles, rays, threads),
            lambda gbuffer: gbuffer.face,
        ),
    }
    return [
        Contender(OURS, name, lambda: None, lambda _, run=run: run(), lambda result, face=face: face(result).ravel())
        for name, (run, face) in queries.items()
    ]


def measure(view, options) -> list[dict]:
    """Rows for all thread counts."""
    triangles, table = view.triangles, []
    rays = view.camera.rays(triangles.origin)
    peer_rays = primary_rays(rays)
    counters = new_raster_counters()
    rasterise(triangles.vertices.reshape(-1, 9), rays, counters=counters)
    counts = ", ".join(f"{k} {v}" for k, v in zip(RASTER_COUNTERS, counters))
    print(f"\n{view.name}: {len(triangles.vertices)} triangles; rasteriser: {counts}")
    tree = block_tree(BUILDERS[BUILDER].build(triangles.vertices, None))
    with embree_scenes(triangles.vertices, options.isa) as built:
        for threads in options.threads:
            contenders = our_contenders(tree, triangles, rays, threads)
            contenders += embree_contenders(built, peer_rays, ("pixels",), True, threads)
            results, faces = contest(contenders, peer_rays.active, options.rounds, options.clock, progress)
            progress("")
            case = {"scene": view.name, "triangles": len(triangles.vertices), "threads": threads}
            case |= {"clock": options.clock, "hit": float((faces >= 0).mean())}
            print(f"\n{view.name}, {(faces >= 0).mean():.1%} of the pixels hit, {threads} thread(s)\n{HEAD}")
            table += rows(case, results, len(faces))
            print("\n".join(line(row) for row in table[-len(results) :]), flush=True)
    return table


def main() -> None:
    options = options_of(argparse.ArgumentParser(description=__doc__.splitlines()[0]))
    for gbuffer in ("rays", "raster"):
        precompile_plan(Plan(build=BUILDER), gbuffer, False)
    compare(options, measure)


if __name__ == "__main__":
    start(main)
