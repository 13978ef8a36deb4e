"""Time to find what each pixel sees: the rasteriser beside Embree's rtcIntersect1, in one process, turn by turn.

    python benchmarks/gbuffer.py [scene ...] [--size W H] [--threads N] [--rounds N] [--json FILE]

A scene is a file that `antumbra.load` reads; the camera comes from an info.json beside it, else it is the default one.
Without a scene: Sponza and San Miguel from the folder of real scenes ($ANTUMBRA_SCENES, or ../shared/scenes beside the
repository).

What is timed: `rasterise` from the vertices to face and t of each pixel; `gbuffer`, the same and then positions and
normals; `embree`, rtcIntersect1 with the coherent flag for the same rays, made beforehand in tiles of 16 x 16 pixels,
called from as many threads in a compiled loop, its tree built beforehand. Kernels are compiled before.
"""

import ctypes
import json
import statistics
import sys
import time
from pathlib import Path

import numba
import numpy as np

import antumbra
from antumbra.bench import embree
from antumbra.parallel import CHUNK, N, new_ticket, run, take, thread_count
from antumbra.query.gbuffer import from_hits
from antumbra.query.raster import RASTER_COUNTERS, new_raster_counters, rasterise
from antumbra.scene.camera import Camera
from antumbra.scene.framing import default_camera
from common import SCENES, arguments, machine

REAL = ("sponza_crytek", "sanmiguel_lite")
TILE = 16
intersect1 = embree.functions().intersect1


@numba.njit(nogil=True)
def trace(ticket, scene, arguments, rays, face, t):
    """Worker: rays is (n, 8) float32, origin, tnear, direction, time."""
    record = np.zeros(20, np.float32)
    whole = record.view(np.int32)
    first = take(ticket)
    while first >= 0:
        for i in range(first, min(first + ticket[CHUNK], ticket[N])):
            for k in range(8):
                record[k] = rays[i, k]
            record[8], whole[9], whole[17], whole[18] = np.inf, -1, -1, -1  # tfar, mask; no hit yet
            intersect1(scene, record.ctypes.data, arguments)
            face[i], t[i] = whole[17], record[8]
        first = take(ticket)


def tiled(picture: np.ndarray) -> np.ndarray:
    """The pixels of (H, W, ...) in the order of tiles, as rows."""
    height, width = picture.shape[:2]
    y, x = np.mgrid[:height, :width].reshape(2, -1)
    order = np.lexsort((x % TILE, y % TILE, x // TILE, y // TILE))
    return np.ascontiguousarray(picture.reshape(height * width, -1)[order])


def ray_records(rays) -> np.ndarray:
    """(pixels, 8) float32, in the order of tiles."""
    y, x = np.mgrid[: rays.height, : rays.width][..., None]
    records = np.zeros((rays.height, rays.width, 8), np.float32)
    records[..., :3] = rays.origin
    records[..., 4:7] = rays.corner + (x + 0.5) * rays.dx + (y + 0.5) * rays.dy
    return tiled(records)


def scenes(paths: list[Path], size):
    """(name, triangles, camera) of each scene."""
    paths = paths or [p for name in REAL if (p := SCENES / name / "scene.glb").exists()]
    if not paths:
        sys.exit(f"no scene is given and none is in {SCENES}: name a scene file, or set ANTUMBRA_SCENES")
    for path in paths:
        info = path.with_name("info.json")
        info = json.loads(info.read_text()) if info.exists() else {}
        up = info.get("up", [0, 1, 0])
        scene = antumbra.load(path, up="z" if up[2] else "y")
        if "camera" in info:
            own = info["camera"]
            camera = Camera(own["position"], own["target"], up, own["vfov"], *size)
        else:
            camera = default_camera(scene.bounds, scene.up, *size)
        yield path.parent.name if path.stem == "scene" else path.stem, scene.triangles(0.0), camera


def measure(name: str, triangles, camera, threads: int, rounds: int) -> list[dict]:
    """One row for each method."""
    corners, rays = triangles.vertices.reshape(-1, 9), camera.rays(triangles.origin)
    records, settings = ray_records(rays), embree.arguments(coherent=True)
    face, t = np.empty(len(records), np.int32), np.empty(len(records), np.float32)
    with embree.Device(threads) as device, embree.EmbreeScene(device, triangles.vertices) as scene:
        arguments = (scene.handle, ctypes.addressof(settings), records, face, t)
        methods = {
            "rasterise": lambda: rasterise(corners, rays, threads),
            "gbuffer": lambda: from_hits(*rasterise(corners, rays, threads), triangles, rays, threads),
            "embree": lambda: run(trace, threads, new_ticket(len(records), 1024), *arguments),
        }
        seconds = {k: [] for k in methods}
        for turn in range(rounds + 1):
            for k, method in methods.items():
                start = time.perf_counter()
                method()
                if turn:  # the first one compiles
                    seconds[k].append(time.perf_counter() - start)
    counters = new_raster_counters()
    ours = rasterise(corners, rays, threads, counters=counters)[0]
    facts = {
        "agrees": float((tiled(ours).ravel() == face).mean()),
        **{k: int(v) for k, v in zip(RASTER_COUNTERS, counters)},
    }
    peer = statistics.median(seconds["embree"])
    return [
        {
            "scene": name,
            "triangles": len(corners),
            "size": [rays.width, rays.height],
            "method": k,
            "median_ms": 1e3 * statistics.median(s),
            "min_ms": 1e3 * min(s),
            "max_ms": 1e3 * max(s),
            "times_faster": peer / statistics.median(s),
            "of_minima": min(seconds["embree"]) / min(s),
            **(facts if k != "embree" else {}),
        }
        for k, s in seconds.items()
    ]


def line(row: dict) -> str:
    own = ""
    if "agrees" in row:
        own = f"{row['agrees']:8.5f} {row['uncertain'] / row['pixels']:9.1e} {row['ties'] / row['pixels']:9.1e}"
    times = f"{row['median_ms']:9.1f} {row['min_ms']:8.1f} {row['max_ms']:8.1f}"
    return f"{row['scene']:20s} {row['method']:10s} {times} {row['times_faster']:7.2f} {row['of_minima']:7.2f} {own}"


def main() -> None:
    parser = arguments(__doc__)
    parser.add_argument("--size", type=int, nargs=2, default=(1024, 1024), metavar=("W", "H"))
    options = parser.parse_args()
    threads = thread_count(options.threads)
    print(
        f"{'scene':20s} {'method':10s} {'median ms':>9s} {'min':>8s} {'max':>8s} {'faster':>7s} {'of mins':>7s} "
        f"{'agrees':>8s} {'uncertain':>9s} {'ties':>9s}"
    )
    rows = []
    for name, triangles, camera in scenes(options.scene, options.size):
        for row in measure(name, triangles, camera, threads, options.rounds):
            rows.append(row)
            print(line(row), flush=True)
    if options.json:
        options.json.write_text(json.dumps({"machine": machine(threads), "rows": rows}, indent=1))


if __name__ == "__main__":
    main()
