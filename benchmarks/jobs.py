"""Times of jobs: who sees whom, baking, images of the viewer, and a store larger than memory.

    python benchmarks/jobs.py [SCENE ...] [--only PART ...] [--points N] [--spp N] [--size W H] [--store N]
        [--json FILE]

- `matrix`: which of N points on the surfaces of a scene see each other, by `antumbra.visibility_matrix`.
- `bake`: ambient occlusion at the vertices of a scene, by `antumbra.bake`, with N rays per vertex.
- `viewer`: the images of `antumbra.view` after a move, from coarse to fine, in a scene whose tree is not built yet.
- `store`: `antumbra build` of a procedural city of N triangles, and frames of it from a street, in 2 GiB of memory.

The scenes are Sponza (matrix), the bunny (bake), Sponza and a city (viewer) from $ANTUMBRA_SCENES, or the named ones.
Times are seconds of CPU of all threads (process time), except for `store`, which waits for the disk: wall seconds.
Medians over --rounds; a round of `viewer` has a new scene. `store` runs once.
"""

import json
import multiprocessing
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import antumbra as at
from antumbra.store.system_resources import peak_resident_memory
from antumbra.viewer.progressive_pictures import PICTURE_STEPS, trace_picture
from antumbra.viewer.viewer_model import Model
from common import SCENES, arguments, machine

PARTS = "matrix", "bake", "viewer", "store"
STORE_MEMORY = 2 << 30  # bytes
FRAMES = 8  # of a store, along a street


def median_seconds(call: Callable[[], object], rounds: int) -> float:
    """CPU seconds of a call, after one that loads its kernels."""
    call()
    seconds = []
    for _ in range(rounds):
        start = time.process_time()
        call()
        seconds.append(time.process_time() - start)
    return statistics.median(seconds)


def matrix(path: Path, options, folder: Path) -> dict:
    scene = at.load(path)
    area = at.face_sensors(scene).areas.sum()
    sensors = at.grid_sensors(scene, float((area / options.points) ** 0.5))
    matrices = (folder / f"{k}.npy" for k in range(options.rounds + 1))  # a finished file would not be computed again
    seconds = median_seconds(lambda: at.visibility_matrix(scene, sensors, output=next(matrices)), options.rounds)
    return {"what": "matrix", "scene": path.parent.name, "points": len(sensors), "seconds": seconds}


def bake(path: Path, options, folder: Path) -> dict:
    made = at.bake(path, folder / "baked.glb", spp=options.spp)
    call = lambda: at.bake(path, folder / "baked.glb", spp=options.spp)
    seconds = median_seconds(call, options.rounds)
    return {"what": "bake", "scene": path.parent.name, "points": made.receivers, "rays": made.rays, "seconds": seconds}


def viewer(load: Callable[[], at.Scene], name: str, options) -> list[dict]:
    """Seconds of each image; the first one includes the tree."""
    seconds: list[list[float]] = [[] for _ in PICTURE_STEPS]
    triangles = 0
    for turn in range(options.rounds + 1):
        scene = load()
        model, triangles = Model(scene), scene.n_triangles
        camera = scene.default_camera(*options.size)
        for step, row in zip(PICTURE_STEPS, seconds):
            start = time.process_time()
            trace_picture(model, camera, step)
            if turn:  # the first turn loads kernels
                row.append(time.process_time() - start)
    about = {"what": "viewer", "scene": name, "triangles": triangles}
    return [
        {**about, "step": str(step), "seconds": statistics.median(row)} for step, row in zip(PICTURE_STEPS, seconds)
    ]


def _frames_of_store(path: Path, size: tuple[int, int], results) -> None:
    scene = at.load(path)
    renderer, seconds = at.Renderer(scene, max_memory=STORE_MEMORY), []
    for k in range(FRAMES):
        camera = at.Camera((7.0, 1.7, 30.0 - k), (7.0, 3.0, -60.0), width=size[0], height=size[1])
        start = time.perf_counter()
        renderer.render(camera, scene.lights, spp=4)
        seconds.append(time.perf_counter() - start)
    results.put((seconds, peak_resident_memory()))


def store(triangles: int, options, folder: Path) -> dict:
    """Wall seconds and memory: building in a process of its own, then frames in another one."""
    path = folder / "city.antumbra"
    command = [sys.executable, "-m", "antumbra", "build", f"procedural:city?triangles={triangles}", "-o", path]
    start = time.perf_counter()
    subprocess.run([*command, "--max-memory", str(STORE_MEMORY), "--quiet"], check=True)
    build = time.perf_counter() - start
    spawn = multiprocessing.get_context("spawn")
    results = spawn.SimpleQueue()
    child = spawn.Process(target=_frames_of_store, args=(path, tuple(options.size), results))
    child.start()
    seconds, peak = results.get()
    child.join()
    return {
        "what": "store",
        "triangles": triangles,
        "bytes": path.stat().st_size,
        "build": build,
        "first": seconds[0],
        "later": statistics.median(seconds[1:]),
        "peak": peak,
    }


def main() -> None:
    parser = arguments(__doc__)
    parser.set_defaults(rounds=3)
    parser.add_argument("--only", nargs="+", choices=PARTS, default=PARTS, metavar="PART")
    parser.add_argument("--points", type=int, default=100_000, help="of the matrix")
    parser.add_argument("--spp", type=int, default=256, help="rays per vertex of the bake")
    parser.add_argument("--size", type=int, nargs=2, default=(1280, 800), metavar=("W", "H"))
    parser.add_argument("--store", type=int, default=10_000_000, metavar="N", help="triangles of the store")
    options = parser.parse_args()
    sponza, bunny = (SCENES / name / "scene.glb" for name in ("sponza_crytek", "stanford_bunny"))
    rows: list[dict] = []
    with tempfile.TemporaryDirectory() as temporary:
        folder = Path(temporary)
        if "matrix" in options.only:
            rows += [matrix(path, options, folder) for path in options.scene or [sponza]]
        if "bake" in options.only:
            rows += [bake(path, options, folder) for path in options.scene or [bunny]]
        if "viewer" in options.only:
            for path in options.scene or [sponza]:
                rows += viewer(lambda path=path: at.load(path), path.parent.name, options)
            if not options.scene:
                rows += viewer(lambda: at.procedural("city", triangles=1_000_000), "city", options)
        if "store" in options.only:
            rows.append(store(options.store, options, folder))
    for row in rows:
        print(
            ", ".join(
                f"{key} {value:,.2f}" if isinstance(value, float) else f"{key} {value}" for key, value in row.items()
            )
        )
    if options.json:
        options.json.write_text(json.dumps({"machine": machine(options.threads or 0), "rows": rows}, indent=1) + "\n")


if __name__ == "__main__":
    main()
