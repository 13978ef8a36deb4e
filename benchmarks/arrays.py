"""Ray queries on NumPy arrays: `Scene.occluded` or `Scene.closest_hit`, Embree, embreex and Open3D, in one process.

    python benchmarks/arrays.py [scene ...] [--query occluded|closest] [--kind KIND] [--rays N] [--threads N]
        [--rounds N] [--clock wall|cpu] [--fresh] [--json FILE]

A scene is a file that `antumbra.load` reads, or the name of a procedural scene. Camera and light of a file come from an
info.json beside it, if it exists. The default scenes are the procedural forest and three real scenes (Sponza, San
Miguel and the robots) from $ANTUMBRA_SCENES, or from ../shared/scenes beside the repository.

Rays of `occluded` are segments (tmax = 1). Coherent rays go from the visible surfaces of a picture, row by row, to a
point on the light. Incoherent rays connect random pairs of points in the scene's bounds. Rays of `closest` have no end:
camera rays of a picture, row by row; bounce rays from its visible surfaces in random directions; and random rays
through pairs of points as above.

Timed calls, which alternate:

- `occluded` and `closest`: the whole call, from arrays to arrays.
- `embree 1` and `embree 16`: rtcOccluded1 and rtcOccluded16, or rtcIntersect1 and rtcIntersect16, in compiled loops on
  the same number of threads, with the coherent flag for coherent and camera rays, in trees of medium and high build
  quality. The times do *not* include writing the ray records and reading the answers.
- `embreex` and `open3d`: their own Python calls.

Trees are built and kernels compiled beforehand. A scene optimises its tree once traversal has lost as much time as that
costs, so rays are traced until then, and a line reports how long it took. With --fresh, the scene keeps its first tree.
"""

import json
import statistics
import time
from functools import partial
from pathlib import Path
from typing import NamedTuple

import numpy as np

import antumbra
from antumbra.engine.auto.cost_model import best_pays
from antumbra.engine.sources.in_memory_source import RAY_PLANS
from antumbra.generate.procedural_scenes import PROCEDURAL
from antumbra.kernels.parallel import thread_count
from antumbra.query.gbuffer import from_hits
from antumbra.query.rasteriser import rasterise
from antumbra.query.receivers import NOTHING, surface_receivers
from common import SCENES, arguments, has_embree, installed, machine
from peers import embree, open3d_rays
from peers.embree import RAY_WORDS, faces_of, occluded_of, trace, write
from peers.ray_contest import primary_rays, ray_set

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


class Rays(NamedTuple):
    """Rays of one kind."""

    origins: np.ndarray  # (n, 3) float32, world space
    directions: np.ndarray  # (n, 3) float32
    tmax: float


def _picture(scene, camera, n: int):
    """(triangles, a picture's rays, its visible surfaces) for at least n pixels.

    The surfaces are `surface_receivers`, in the scene's frame, and their normals on the visible side.
    """
    width = 16 * int(np.ceil((n * 16 / 9) ** 0.5 / 16))
    triangles = scene.triangles(0.0)
    corners, rays = triangles.vertices.reshape(-1, 9), camera.resized(width, -(-n // width)).rays(triangles.origin)
    gbuffer = from_hits(*rasterise(corners, rays), triangles, rays)
    flat = [a.reshape(-1, *a.shape[2:]) for a in (gbuffer.position, gbuffer.normal, gbuffer.face, gbuffer.side)]
    position, normal, face, side = (a[flat[3] != NOTHING] for a in flat)
    return triangles, rays, surface_receivers(position, normal, face, side, corners), normal * side[:, None]


def coherent(scene, camera, point, n: int) -> Rays:
    """Segments from visible surfaces to the point."""
    triangles, _, origins, _ = _picture(scene, camera, n)
    origins = np.resize((origins + triangles.origin).astype(np.float32), (n, 3))
    return Rays(origins, (point - origins).astype(np.float32), 1.0)


def incoherent(scene, n: int, tmax: float = 1.0) -> Rays:
    """Segments, or rays, between random points in the scene's bounds."""
    a, b = np.random.default_rng(0).uniform(*scene.bounds, (2, n, 3)).astype(np.float32)
    return Rays(a, b - a, tmax)


def camera_rays(scene, camera, n: int) -> Rays:
    """Rays through the pixel centres of a picture, row by row."""
    triangles, rays, _, _ = _picture(scene, camera, n)
    directions = primary_rays(rays).directions[:n]
    return Rays(np.tile((rays.origin + triangles.origin).astype(np.float32), (n, 1)), directions, np.inf)


def bounce(scene, camera, n: int) -> Rays:
    """Rays from visible surfaces in random directions on their visible side."""
    triangles, _, origins, normals = _picture(scene, camera, n)
    directions = np.random.default_rng(0).normal(size=origins.shape)
    directions *= np.copysign(1.0, (directions * normals).sum(1, keepdims=True))
    origins = (origins + triangles.origin).astype(np.float32)
    return Rays(np.resize(origins, (n, 3)), np.resize(directions.astype(np.float32), (n, 3)), np.inf)


KINDS = {
    "occluded": {
        "coherent": lambda scene, camera, point, n: coherent(scene, camera, point, n),
        "incoherent": lambda scene, camera, point, n: incoherent(scene, n),
    },
    "closest": {
        "camera": lambda scene, camera, point, n: camera_rays(scene, camera, n),
        "bounce": lambda scene, camera, point, n: bounce(scene, camera, n),
        "random": lambda scene, camera, point, n: incoherent(scene, n, np.inf),
    },
}
COHERENT = "coherent", "camera"
TFAR = 8  # word of an RTCRay
QUALITIES = "medium", "high"


class Records:
    """Embree's scenes, and the rays in its layout: single rays, and packets of 16."""

    def __init__(self, scene, query: str, rays: Rays, threads: int):
        self.closest = query == "closest"
        origins = (rays.origins - scene.origin).astype(np.float32)
        self.local = ray_set(origins, rays.directions, rays.tmax)
        self.device = embree.Device(threads)
        vertices = scene.triangles(0.0).vertices
        self.scenes = {quality: embree.EmbreeScene(self.device, vertices, quality=quality) for quality in QUALITIES}
        ids = np.arange(len(origins), dtype=np.int32)
        self.single = write(self.local, ids, self.closest, threads)
        self.packets = write(self.local, ids.reshape(-1, 16), self.closest, threads)

    def fresh(self) -> None:
        """Reset the records before a trace."""
        for records, first in ((self.single, 0), (self.packets, 1)):  # a packet begins with its mask
            records.memory[:, first + TFAR] = self.local.tmax
            records.memory.view(np.int32)[:, first + RAY_WORDS :] = -1

    def answers(self) -> np.ndarray:
        """(n,) bool or int32: the answers in the packets, as `occluded` or faces."""
        return faces_of(self.local, self.packets) if self.closest else occluded_of(self.local, self.packets)

    def close(self) -> None:
        for scene in self.scenes.values():
            scene.close()
        self.device.close()


def settle(name: str, scene, rays: Rays) -> None:
    """Trace rays until the scene has optimised its tree, which very large scenes never do."""
    if not best_pays(np.inf, scene.n_triangles):
        return
    start, n_rays = time.perf_counter(), 0
    while str(scene.engine.source.ray_lists.plan) != RAY_PLANS[1]:
        scene.occluded(*rays)
        n_rays += len(rays.origins)
    scene.occluded(rays.origins[:1], rays.directions[:1])
    print(f"{name}: tree optimised after {n_rays / 1e6:.0f} M rays, {time.perf_counter() - start:.1f} s in total")


def ask(scene, query: str, rays: Rays, threads: int, fresh: bool) -> np.ndarray:
    """Our call: (n,) bool or faces. fresh: reset the traversal time that triggers an optimisation."""
    if fresh:
        scene.engine.source.ray_lists.spent = 0.0
    if query == "closest":
        return scene.closest_hit(rays.origins, rays.directions, threads=threads).face
    return scene.occluded(rays.origins, rays.directions, tmax=rays.tmax, threads=threads)


def methods(scene, query: str, rays: Rays, is_coherent: bool, threads: int, peer: Records | None, fresh: bool):
    """Name -> function that traces the rays."""
    calls = {query: lambda: ask(scene, query, rays, threads, fresh)}
    if peer:
        for quality, built in peer.scenes.items():
            calls[f"embree 1 {quality}"] = partial(trace, built, peer.single, is_coherent, threads)
            calls[f"embree 16 {quality}"] = partial(trace, built, peer.packets, is_coherent, threads)
        calls["embreex"] = _embreex(scene, query, rays)
    if installed(open3d_rays.library):
        calls["open3d"] = _open3d(scene, query, rays, threads)
    return calls


def _embreex(scene, query: str, rays: Rays):
    from embreex import rtcore_scene
    from embreex.mesh_construction import TriangleMesh

    embree_scene = rtcore_scene.EmbreeScene()
    mesh = TriangleMesh(embree_scene, (scene.triangles(0.0).vertices + scene.origin).astype(np.float32))
    options = {"query": "OCCLUDED", "dists": rays.tmax} if query == "occluded" else {"query": "INTERSECT"}
    return lambda: (embree_scene.run(rays.origins, rays.directions, **options), mesh)


def _open3d(scene, query: str, rays: Rays, threads: int):
    open3d = open3d_rays.library()
    raycasting = open3d.t.geometry.RaycastingScene(nthreads=threads)
    vertices = (scene.triangles(0.0).vertices + scene.origin).astype(np.float32).reshape(-1, 3)
    raycasting.add_triangles(vertices, np.arange(len(vertices), dtype=np.uint32).reshape(-1, 3))
    six = open3d.core.Tensor(np.concatenate([rays.origins, rays.directions], 1))
    if query == "occluded":
        return lambda: raycasting.test_occlusions(six, tfar=rays.tmax, nthreads=threads)
    return lambda: raycasting.cast_rays(six, nthreads=threads)


CLOCKS = {"wall": time.perf_counter, "cpu": time.process_time}


def measure(name: str, scene, query: str, kind: str, rays: Rays, threads: int, options) -> list[dict]:
    """A row per method."""
    peer, clock = Records(scene, query, rays, threads) if has_embree() else None, CLOCKS[options.clock]
    calls, differ = methods(scene, query, rays, kind in COHERENT, threads, peer, options.fresh), None
    seconds: dict[str, list[float]] = {k: [] for k in calls}
    for turn in range(options.rounds + 1):
        for k, call in calls.items():
            if peer:
                peer.fresh()
            start = clock()
            result = call()
            if turn:  # the first turn compiles and builds
                seconds[k].append(clock() - start)
            if k == query:
                ours = result
            if k == "embree 16 medium":
                differ = int((peer.answers() != ours).sum())
    if peer:
        peer.close()
    n, our_seconds = len(rays.origins), statistics.median(seconds[query])
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
            "of_minima": min(s) / min(seconds[query]),
            "hit": float((ours if query == "occluded" else ours >= 0).mean()),
            "differ_from_embree": differ,  # None: without Embree; faces at the same t count too
        }
        for k, s in seconds.items()
    ]


def line(row: dict) -> str:
    differ = "" if row["differ_from_embree"] is None else row["differ_from_embree"]
    return (
        f"{row['scene']:16s} {row['kind']:10s} {row['threads']:3d} {row['method']:16s} {row['median_ms']:9.1f} "
        f"{row['min_ms']:9.1f} {row['million_rays_per_second']:8.2f} {row['we_are_faster']:7.2f} "
        f"{row['of_minima']:7.2f} {row['hit']:6.3f} {differ:>8}"
    )


def main() -> None:
    parser = arguments(__doc__)
    parser.set_defaults(rounds=5, threads=None)
    parser.add_argument("--rays", type=int, default=10_000_000)
    parser.add_argument("--query", choices=tuple(KINDS), default="occluded")
    parser.add_argument("--kind", choices=[kind for kinds in KINDS.values() for kind in kinds])
    parser.add_argument("--clock", choices=tuple(CLOCKS), default="wall")
    parser.add_argument("--fresh", action="store_true", help="measure the first tree, not the optimised one")
    options = parser.parse_args()
    counts = [options.threads] if options.threads else sorted({1, thread_count(None)})
    n = options.rays // 16 * 16
    paths = options.scene or [p for s in REAL if (p := SCENES / s / "scene.glb").exists()] + [Path("forest")]
    print(
        f"{'scene':16s} {'rays':10s} {'thr':>3s} {'method':16s} {'median ms':>9s} {'min':>9s} {'Mray/s':>8s} "
        f"{'faster':>7s} {'of mins':>7s} {'hit':>6s} {'differ':>8s}"
    )
    rows = []
    for path in paths:
        name, scene, camera, point = load(path)
        if not options.fresh:
            settle(name, scene, incoherent(scene, n))
        for kind, rays_of in KINDS[options.query].items():
            if options.kind not in (None, kind):
                continue
            rays = rays_of(scene, camera, point, n)
            for threads in counts:
                for row in measure(name, scene, options.query, kind, rays, threads, options):
                    rows.append(row)
                    print(line(row), flush=True)
    if options.json:
        options.json.write_text(json.dumps({"machine": machine(max(counts)), "rows": rows}, indent=1))


if __name__ == "__main__":
    main()
