"""Geometry that moves between queries: `Scene.update` and `Scene.occluded`, and Embree's dynamic scene beside them.

    python benchmarks/update.py [scene ...] [--triangles N] [--rays N] [--threads N] [--rounds N] [--clock C]
        [--json FILE]

A scene is "water", a grid of N triangles; the name of a procedural scene, generated with N triangles; or a file. Its
vertices follow a wave, whose phase differs from round to round, and then the same segments are traced: coherent ones,
from the visible surfaces of a picture to a point on the light, or incoherent ones, between random points in the bounds.

Timed for ours: both calls, from the array of vertices, (v, 3) float32, to the array of answers. `occluded` includes the
refit of the tree, or its rebuild once rays have lost as much time as that takes.

Timed for Embree: the refit of a dynamic scene of low build quality, the only kind that Embree refits, or a new build of
low or medium quality; and the same segments one by one or in packets of 16, in compiled loops on the same number of
threads. Copying vertices into Embree's buffer, writing the ray records and reading the answers are *not* timed.

`wrong` counts answers of the last round that differ from those of a new scene. `differs` counts those that differ from
Embree's, which are subject to rounding.
"""

import json
import statistics
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from pathlib import Path
from typing import NamedTuple

import numpy as np

import antumbra
from antumbra.generate.procedural_scenes import PROCEDURAL
from antumbra.kernels.parallel import thread_count
from antumbra.scene.scene_bounds import faces_of
from arrays import CLOCKS, Rays, coherent, incoherent, load
from common import arguments, has_embree, machine
from peers import embree
from peers.embree import occluded_of, trace, write
from peers.ray_contest import ray_set

OURS = "update + occluded"
AMPLITUDE, WAVES = 0.01, 3.0  # of the wave, relative to the diagonal of the scene; wavelengths per diagonal
BUILDS = {"refit": ("low", True), "low": ("low", False), "medium": ("medium", False)}  # (quality, whether to refit)


class MovingMesh(NamedTuple):
    """A mesh whose vertices follow a wave."""

    name: str
    vertices: np.ndarray  # (v, 3) float32, world, at rest
    faces: np.ndarray  # (f, 3) int32
    still: antumbra.Scene  # the scene at rest, with its camera
    camera: antumbra.Camera
    light: np.ndarray  # (3,), the point to which coherent segments lead

    def moved(self, phase: float) -> np.ndarray:
        """(v, 3) float32, world: the vertices at a phase of the wave, in radians."""
        lower, upper = self.still.bounds
        size = float(np.linalg.norm(upper - lower))
        waves = np.sin(2.0 * np.pi * WAVES / size * (self.vertices - lower) + phase)
        return (self.vertices + AMPLITUDE * size * np.roll(waves, 1, axis=1)).astype(np.float32)


def water(triangles: int) -> MovingMesh:
    """A square grid, as of water or cloth."""
    n = max(int((triangles / 2) ** 0.5), 2)
    x, z = np.meshgrid(np.linspace(-1.0, 1.0, n + 1), np.linspace(-1.0, 1.0, n + 1))
    height = 0.05 * np.sin(9.0 * x + 2.0 * z) * np.cos(7.0 * z)
    corner = (np.arange(n)[:, None] * (n + 1) + np.arange(n)).ravel()
    faces = np.concatenate([corner + [[0], [n + 1], [1]], corner + [[1], [n + 1], [n + 2]]], axis=1).T
    vertices, faces = np.stack([x, height, z], -1).reshape(-1, 3).astype(np.float32), faces.astype(np.int32)
    camera = antumbra.Camera((0.0, 0.8, 1.6), (0.0, 0.0, 0.0))
    still = antumbra.Scene.from_arrays(vertices, faces, name="water")
    return MovingMesh("water", vertices, faces, still, camera, np.array([1.5, 0.2, -1.5]))


def mesh_of(path: Path, triangles: int) -> MovingMesh:
    """The mesh of a procedural scene or a file."""
    if str(path) == "water":
        return water(triangles)
    if str(path) in PROCEDURAL:
        still = antumbra.procedural(str(path), triangles=triangles)
        patch = still.lights[0].patch(np.zeros(3), 2.0 * float(np.linalg.norm(np.diff(still.bounds, axis=0))))
        name, camera, light = str(path), still.cameras[0], patch.base + (patch.u + patch.v) / 2
    else:
        name, still, camera, light = load(path)
    positions, faces, count = [], [], 0
    for piece in still.source.pieces(0.0):
        for copy in piece.vertices:
            indices = np.arange(3 * faces_of(piece)).reshape(-1, 3) if piece.faces is None else piece.faces
            positions.append(np.asarray(copy, np.float32))
            faces.append(indices + count)
            count += len(copy)
    return MovingMesh(name, np.concatenate(positions), np.concatenate(faces), still, camera, light)


class Timed(NamedTuple):
    """One round of a method."""

    update: float  # seconds of `Scene.update`, or of Embree's commit
    trace: float  # seconds of `Scene.occluded`, which includes our refit; or of Embree's rays
    blocked: np.ndarray  # (n,) bool


class Setting(NamedTuple):
    """How all methods run."""

    threads: int
    clock: Callable[[], float]  # seconds


def ours(mesh: MovingMesh, rays: Rays, setting: Setting) -> Callable[[np.ndarray], Timed]:
    """A function of the vertices that moves our scene and traces the rays."""
    threads, clock = setting
    scene = antumbra.Scene.from_arrays(mesh.vertices, mesh.faces)
    scene.occluded(rays.origins, rays.directions, tmax=rays.tmax, threads=threads)

    def run(vertices: np.ndarray) -> Timed:
        start = clock()
        scene.update(vertices, threads=threads)
        middle = clock()
        blocked = scene.occluded(rays.origins, rays.directions, tmax=rays.tmax, threads=threads)
        return Timed(middle - start, clock() - middle, blocked)

    return run


def peers(
    mesh: MovingMesh, rays: Rays, is_coherent: bool, setting: Setting, stack: ExitStack
) -> Iterator[tuple[str, Callable[[np.ndarray], Timed]]]:
    """Embree's builds with single rays and packets: (name, function of the vertices)."""
    threads, clock = setting
    device, origin = stack.enter_context(embree.Device(threads)), mesh.still.origin
    local = ray_set((rays.origins - origin).astype(np.float32), rays.directions, rays.tmax)
    ids = np.arange(len(rays.origins), dtype=np.int32)
    for build, (quality, refit) in BUILDS.items():
        vertices = (mesh.vertices - origin).astype(np.float32)
        scene = stack.enter_context(embree.EmbreeScene(device, vertices, mesh.faces, quality, embree.DYNAMIC))
        for lanes in (1, 16):

            def run(vertices, scene=scene, refit=refit, lanes=lanes) -> Timed:
                records = write(local, ids if lanes == 1 else ids.reshape(-1, lanes), threads=threads)
                scene.fill((vertices - origin).astype(np.float32))
                start = clock()
                scene.build_again(refit)
                middle = clock()
                trace(scene, records, is_coherent, threads)
                return Timed(middle - start, clock() - middle, occluded_of(local, records))

            yield f"embree {build} + rtcOccluded{lanes}", run


def measure(mesh: MovingMesh, kind: str, rays: Rays, setting: Setting, rounds: int) -> list[dict]:
    """A row per method."""
    threads = setting.threads
    with ExitStack() as stack:
        methods = {OURS: ours(mesh, rays, setting)}
        if has_embree():
            methods |= dict(peers(mesh, rays, kind == "coherent", setting, stack))
        runs: dict[str, list[Timed]] = {name: [] for name in methods}
        for turn in range(-2, rounds):  # two rounds to warm up
            vertices = mesh.moved(2.0 * np.pi * turn / rounds)
            for name, method in methods.items():
                timed = method(vertices)
                if turn >= 0:
                    runs[name].append(timed)
    new = antumbra.Scene.from_arrays(vertices, mesh.faces)
    new.origin = antumbra.Scene.from_arrays(mesh.vertices, mesh.faces).origin  # the frame stays when a scene moves
    truth = new.occluded(rays.origins, rays.directions, tmax=rays.tmax, threads=threads)
    total = lambda name: statistics.median(each.update + each.trace for each in runs[name])
    case = {"scene": mesh.name, "triangles": len(mesh.faces), "vertices": len(mesh.vertices), "kind": kind}
    case |= {"rays": len(rays.origins), "threads": threads, "blocked": float(truth.mean())}
    return [
        case
        | {
            "method": name,
            "update_ms": 1e3 * statistics.median(each.update for each in timed),
            "trace_ms": 1e3 * statistics.median(each.trace for each in timed),
            "total_ms": 1e3 * total(name),
            "min_ms": 1e3 * min(each.update + each.trace for each in timed),
            "we_are_faster": total(name) / total(OURS),
            "wrong" if name == OURS else "differs": int((timed[-1].blocked != truth).sum()),
        }
        for name, timed in runs.items()
    ]


HEAD = (
    f"{'scene':12s} {'rays':10s} {'thr':>3s} {'method':28s} {'update':>7s} {'trace':>7s} {'total':>7s} {'min':>7s} "
    f"{'faster':>6s} {'differs':>8s}"
)


def line(row: dict) -> str:
    """A row as a line of the table."""
    return (
        f"{row['scene']:12s} {row['kind']:10s} {row['threads']:3d} {row['method']:28s} {row['update_ms']:7.1f} "
        f"{row['trace_ms']:7.1f} {row['total_ms']:7.1f} {row['min_ms']:7.1f} {row['we_are_faster']:6.2f} "
        f"{row.get('wrong', row.get('differs')):8d}"
    )


def main() -> None:
    parser = arguments(__doc__)
    parser.add_argument("--triangles", type=int, default=1_000_000, help="of procedural scenes")
    parser.add_argument("--rays", type=int, default=1_000_000)
    parser.add_argument("--clock", choices=tuple(CLOCKS), default="wall", help="cpu: for one thread on a busy machine")
    options = parser.parse_args()
    threads, n = thread_count(options.threads), options.rays // 16 * 16
    print(HEAD)
    rows = []
    for path in options.scene or [Path("water"), Path("atrium"), Path("city")]:
        mesh = mesh_of(path, options.triangles)
        for kind in ("coherent", "incoherent"):
            still = mesh.still
            rays = coherent(still, mesh.camera, mesh.light, n) if kind == "coherent" else incoherent(still, n)
            for row in measure(mesh, kind, rays, Setting(threads, CLOCKS[options.clock]), options.rounds):
                rows.append(row)
                print(line(row), flush=True)
    if options.json:
        options.json.write_text(json.dumps({"machine": machine(threads), "rows": rows}, indent=1))


if __name__ == "__main__":
    main()
