"""Any-hit queries on NumPy arrays: `Scene.occluded`, Embree, embreex and Open3D, alternating in one process.

    python benchmarks/arrays.py [scene ...] [--rays N] [--threads N ...] [--rounds N] [--fresh] [--json FILE]

A scene is a file that `antumbra.load` reads, or the name of a procedural scene. Camera and light of a file come from an
info.json beside it, if it exists. The default scenes are the procedural forest and three real scenes (Sponza, San
Miguel and the robots) from $ANTUMBRA_SCENES, or from ../shared/scenes beside the repository.

Rays are segments (tmax = 1). Coherent rays go from the visible surfaces of a picture, row by row, to a point on the
light. Incoherent rays connect random pairs of points in the scene's bounds.

Timed calls:

- `occluded`: the whole call, from arrays to an array of bool.
- `embree 1` and `embree 16`: rtcOccluded1 and rtcOccluded16 in compiled loops on the same number of threads, with the
  coherent flag for coherent rays, in trees of medium and high build quality. The times do *not* include writing the ray
  records and reading the answers.
- `embreex` and `open3d`: their own Python calls.

Trees are built and kernels compiled beforehand. A scene optimises its tree once traversal has lost as much time as that
costs, so rays are traced until then, and a line reports how long it took. With --fresh, the scene keeps its first tree.
"""

import json
import statistics
import time
from functools import partial
from pathlib import Path

import numpy as np

import antumbra
from antumbra.engine.auto.cost_model import best_pays
from antumbra.engine.in_memory_source import RAY_PLANS
from antumbra.generate.procedural_scenes import PROCEDURAL
from antumbra.kernels.parallel import thread_count
from antumbra.query.gbuffer import from_hits
from antumbra.query.rasteriser import rasterise
from antumbra.query.receivers import NOTHING, surface_receivers
from common import SCENES, arguments, has_embree, installed, machine
from peers import embree, open3d_rays
from peers.embree import occluded_of, trace, write
from peers.ray_contest import ray_set

REAL = ("sponza_crytek", "sanmiguel_lite", "bart_robots")


def load(name: Path):
    """(name, scene, camera, light point)."""
    if str(name) in PROCEDURAL:
        scene = antumbra.procedural(str(name))
        patch = scene.lights[0].patch(np.zeros(3), 2.0 * float(np.linalg.norm(np.diff(scene.bounds, axis=0))))
        return str(name), scene, scene.cameras[0], patch.base + (patch.u + patch.v) / 2
    info = name.with_name("info.json")
    info = json.loads(info.read_text()) if info.exists() else {}
    up = info.get("up", [0, 1, 0])
    scene = antumbra.load(name, up="z" if up[2] else "y")
    camera, light = scene.default_camera(), scene.default_light()
    point = light.corner + (light.u + light.v) / 2
    if "camera" in info:
        camera = antumbra.Camera(info["camera"]["position"], info["camera"]["target"], up, info["camera"]["vfov"])
    if "light" in info:
        position = np.array(info["light"], float)
        far = 2.0 * float(np.linalg.norm(np.diff(scene.bounds, axis=0)))
        point = position[:3] if len(position) == 3 or position[3] else scene.bounds.mean(0) + position[:3] * far
    return (name.parent.name if name.stem == "scene" else name.stem), scene, camera, point


def coherent(scene, camera, point, n: int):
    """(origins, directions) of n segments from visible surfaces to the point, in world space, float32."""
    width = 16 * int(np.ceil((n * 16 / 9) ** 0.5 / 16))
    triangles = scene.triangles(0.0)
    corners, rays = triangles.vertices.reshape(-1, 9), camera.resized(width, -(-n // width)).rays(triangles.origin)
    gbuffer = from_hits(*rasterise(corners, rays), triangles, rays)
    flat = [a.reshape(-1, *a.shape[2:]) for a in (gbuffer.position, gbuffer.normal, gbuffer.face, gbuffer.side)]
    flat = [a[flat[3] != NOTHING] for a in flat]
    origins = np.resize((surface_receivers(*flat, corners) + triangles.origin).astype(np.float32), (n, 3))
    return origins, (point - origins).astype(np.float32)


def incoherent(scene, n: int):
    """(origins, directions) of n segments between random points in the scene's bounds."""
    a, b = np.random.default_rng(0).uniform(*scene.bounds, (2, n, 3)).astype(np.float32)
    return a, b - a


QUALITIES = "medium", "high"


class Records:
    """Embree's scenes, and the rays in its layout: single rays, and packets of 16."""

    def __init__(self, scene, rays, threads: int):
        origins, directions = rays
        self.local = ray_set((origins - scene.origin).astype(np.float32), directions, 1.0)
        self.device = embree.Device(threads)
        vertices = scene.triangles(0.0).vertices
        self.scenes = {quality: embree.EmbreeScene(self.device, vertices, quality=quality) for quality in QUALITIES}
        ids = np.arange(len(origins), dtype=np.int32)
        self.single = write(self.local, ids, threads=threads)
        self.packets = write(self.local, ids.reshape(-1, 16), threads=threads)

    def fresh(self) -> None:
        """Reset the records before a trace."""
        self.single.memory[:, 8], self.packets.memory[:, 9] = 1.0, 1.0  # tfar; a packet begins with its mask

    def answers(self) -> np.ndarray:
        """(n,) bool: the answers in the packets."""
        return occluded_of(self.local, self.packets)

    def close(self) -> None:
        for scene in self.scenes.values():
            scene.close()
        self.device.close()


def settle(name: str, scene, rays) -> None:
    """Trace rays until the scene has optimised its tree, which very large scenes never do."""
    if not best_pays(np.inf, scene.n_triangles):
        return
    start, n_rays = time.perf_counter(), 0
    while str(scene.engine.source.ray_lists.plan) != RAY_PLANS[1]:
        scene.occluded(*rays, tmax=1.0)
        n_rays += len(rays[0])
    scene.occluded(*(side[:1] for side in rays))
    print(f"{name}: tree optimised after {n_rays / 1e6:.0f} M rays, {time.perf_counter() - start:.1f} s in total")


def ask(scene, origins, directions, threads: int, fresh: bool) -> np.ndarray:
    """Our call. fresh: reset the traversal time that triggers an optimisation."""
    if fresh:
        scene.engine.source.ray_lists.spent = 0.0
    return scene.occluded(origins, directions, tmax=1.0, threads=threads)


def methods(scene, rays, is_coherent: bool, threads: int, peer: Records | None, fresh: bool):
    """Name -> function that traces the rays."""
    origins, directions = rays
    calls = {"occluded": lambda: ask(scene, origins, directions, threads, fresh)}
    if peer:
        for quality, built in peer.scenes.items():
            calls[f"embree 1 {quality}"] = partial(trace, built, peer.single, is_coherent, threads)
            calls[f"embree 16 {quality}"] = partial(trace, built, peer.packets, is_coherent, threads)
        calls["embreex"] = _embreex(scene, origins, directions)
    if installed(open3d_rays.library):
        calls["open3d"] = _open3d(scene, origins, directions, threads)
    return calls


def _embreex(scene, origins, directions):
    from embreex import rtcore_scene
    from embreex.mesh_construction import TriangleMesh

    embree_scene = rtcore_scene.EmbreeScene()
    mesh = TriangleMesh(embree_scene, (scene.triangles(0.0).vertices + scene.origin).astype(np.float32))
    return lambda: (embree_scene.run(origins, directions, dists=1.0, query="OCCLUDED"), mesh)


def _open3d(scene, origins, directions, threads):
    open3d = open3d_rays.library()
    raycasting = open3d.t.geometry.RaycastingScene(nthreads=threads)
    vertices = (scene.triangles(0.0).vertices + scene.origin).astype(np.float32).reshape(-1, 3)
    raycasting.add_triangles(vertices, np.arange(len(vertices), dtype=np.uint32).reshape(-1, 3))
    six = open3d.core.Tensor(np.concatenate([origins, directions], 1))
    return lambda: raycasting.test_occlusions(six, tfar=1.0, nthreads=threads)


def measure(name: str, scene, kind: str, rays, threads: int, rounds: int, fresh: bool) -> list[dict]:
    """A row per method."""
    peer = Records(scene, rays, threads) if has_embree() else None
    calls, differ = methods(scene, rays, kind == "coherent", threads, peer, fresh), None
    seconds: dict[str, list[float]] = {k: [] for k in calls}
    for turn in range(rounds + 1):
        for k, call in calls.items():
            if peer:
                peer.fresh()
            start = time.perf_counter()
            result = call()
            if turn:  # the first turn compiles and builds
                seconds[k].append(time.perf_counter() - start)
            if k == "occluded":
                ours = result
            if k == "embree 16 medium":
                differ = int((peer.answers() != ours).sum())
    if peer:
        peer.close()
    n, our_seconds = len(rays[0]), statistics.median(seconds["occluded"])
    return [
        {
            "scene": name,
            "kind": kind,
            "threads": threads,
            "rays": n,
            "method": k,
            "median_ms": 1e3 * statistics.median(s),
            "min_ms": 1e3 * min(s),
            "million_rays_per_second": n / statistics.median(s) / 1e6,
            "we_are_faster": statistics.median(s) / our_seconds,
            "of_minima": min(s) / min(seconds["occluded"]),
            "occluded": float(ours.mean()),
            "differ_from_embree": differ,  # None: without Embree
        }
        for k, s in seconds.items()
    ]


def line(row: dict) -> str:
    differ = "" if row["differ_from_embree"] is None else row["differ_from_embree"]
    return (
        f"{row['scene']:16s} {row['kind']:10s} {row['threads']:3d} {row['method']:16s} {row['median_ms']:9.1f} "
        f"{row['min_ms']:9.1f} {row['million_rays_per_second']:8.2f} {row['we_are_faster']:7.2f} "
        f"{row['of_minima']:7.2f} {row['occluded']:6.3f} {differ:>8}"
    )


def main() -> None:
    parser = arguments(__doc__)
    parser.set_defaults(rounds=5, threads=None)
    parser.add_argument("--rays", type=int, default=10_000_000)
    parser.add_argument("--kind", choices=("coherent", "incoherent"))
    parser.add_argument("--fresh", action="store_true", help="measure the first tree, not the optimised one")
    options = parser.parse_args()
    counts = [options.threads] if options.threads else sorted({1, thread_count(None)})
    n = options.rays // 16 * 16
    paths = options.scene or [p for s in REAL if (p := SCENES / s / "scene.glb").exists()] + [Path("forest")]
    print(
        f"{'scene':16s} {'rays':10s} {'thr':>3s} {'method':16s} {'median ms':>9s} {'min':>9s} {'Mray/s':>8s} "
        f"{'faster':>7s} {'of mins':>7s} {'occl.':>6s} {'differ':>8s}"
    )
    rows = []
    for path in paths:
        name, scene, camera, point = load(path)
        if not options.fresh:
            settle(name, scene, incoherent(scene, n))
        for kind in ("coherent", "incoherent") if not options.kind else (options.kind,):
            rays = coherent(scene, camera, point, n) if kind == "coherent" else incoherent(scene, n)
            for threads in counts:
                for row in measure(name, scene, kind, rays, threads, options.rounds, options.fresh):
                    rows.append(row)
                    print(line(row), flush=True)
    if options.json:
        options.json.write_text(json.dumps({"machine": machine(max(counts)), "rows": rows}, indent=1))


if __name__ == "__main__":
    main()
