"""Error and cost of the discontinuity filter and of adaptive sampling, compared with many samples per pixel.

    python benchmarks/filter_quality.py [scene ...] [--size N] [--threads N] [--rounds N] [--json FILE] [--out DIR]

A scene is the name of a procedural scene, a folder of $ANTUMBRA_SCENES (or ../shared/scenes beside the repository), or
a path. An info.json gives the camera and the light's position. The light is a horizontal square with an edge of 1/50 of
the scene's diagonal. The default scenes are atrium, forest, and, if they exist, sponza_crytek and bart_robots.

Visibility errors are the root mean square and the mean absolute difference from 256 and 1024 samples per pixel over the
pixels with a visible surface, times 1000.

Picture errors are the root mean square difference from a 4 x 4 supersampled picture with 16 samples per sub-pixel, in
8-bit sRGB steps at a common exposure.

`--out` writes the pictures, and crops side by side where 16 samples are worst.
"""

import json
import statistics
from pathlib import Path

import numpy as np
from PIL import Image

import antumbra as at
from antumbra.picture import discontinuity_filter as filter
from antumbra.picture.image_files import automatic_exposure, to_srgb8
from antumbra.query.pixel_refinement import edges
from antumbra.query.surface_links import picture_surfaces
from common import SCENES, arguments, machine

DEFAULT = ("atrium", "forest", "sponza_crytek", "bart_robots")
METHODS = {
    "16": dict(spp=16),
    "16 filtered": dict(spp=16, filter=True),
    "16 filtered, any count": dict(spp=16, filter=True, noise=1e6),
    "16 adaptive 64": dict(spp=16, adaptive=64),
    "16 adaptive 64 filtered": dict(spp=16, adaptive=64, filter=True),
    "64": dict(spp=64),
    "64 filtered": dict(spp=64, filter=True),
    "256": dict(spp=256),
}
SHOWN = ("16", "16 filtered", "16 adaptive 64", "16 adaptive 64 filtered", "256")
CROP, ZOOM = 96, 3  # side of a crop in pixels; its magnification


def opened(name: str, size: int):
    """(scene, camera, lights) of a name."""
    if name in ("atrium", "blinds", "cellar", "city", "courtyard", "forest", "museum", "sculptures"):
        scene = at.procedural(name)
        return scene, scene.cameras[0].resized(size, size), scene.lights
    folder = SCENES / name if (SCENES / name).is_dir() else Path(name)
    info = json.loads((folder / "info.json").read_text())
    file = folder / "scene.glb"
    scene = at.load(file if file.exists() else folder, up="z" if info["up"][2] else "y")
    view = info["camera"]
    side = 0.02 * np.linalg.norm(np.subtract(*scene.bounds))
    u, v = np.eye(3)[[i for i in range(3) if not info["up"][i]]] * side
    light = at.QuadLight(np.asarray(info["light"]) - (u + v) / 2, u, v, intensity=side * side)
    return scene, at.Camera(view["position"], view["target"], info["up"], view["vfov"], size, size), [light]


def rendered(*scene, noise=filter.NOISE, **method):
    """Render a frame with the filter's `NOISE` set to `noise`."""
    default, filter.NOISE = filter.NOISE, noise
    try:
        return at.render(*scene, antialias=False, **method)
    finally:
        filter.NOISE = default


def supersampled(scene, camera, lights, threads) -> np.ndarray:
    """A 4 x 4 supersampled picture."""
    big = camera.resized(4 * camera.width, 4 * camera.height)
    image = at.render(scene, big, lights, threads=threads, antialias=False).image
    return image.reshape(camera.height, 4, camera.width, 4, 3).mean((1, 3), dtype=np.float64).astype(np.float32)


def errors(a, b) -> tuple[float, float]:
    """(root mean square, mean absolute) difference."""
    d = a.astype(np.float64) - b
    return float(np.sqrt((d * d).mean())), float(np.abs(d).mean())


def measure(name: str, options) -> list[dict]:
    """A row per method."""
    scene, camera, lights = opened(name, options.size)
    frames, seconds = {}, {k: [] for k in METHODS}
    for turn in range(options.rounds + 1):
        for k, method in METHODS.items():
            if turn <= 1 or method["spp"] < 256:
                frames[k] = rendered(scene, camera, lights, threads=options.threads, **method)
            if turn:  # the first round loads kernels
                seconds[k].append(frames[k].timings)
    fine = at.render(scene, camera, lights, threads=options.threads, spp=1024)
    reference = supersampled(scene, camera, lights, options.threads)
    visible = fine.gbuffer.face >= 0
    exposure = automatic_exposure(reference, visible)
    pictures = {k: to_srgb8(f.image, exposure) for k, f in frames.items()} | {"truth": to_srgb8(reference, exposure)}
    edge = edges(picture_surfaces(fine.gbuffer, camera.rays(fine.gbuffer.origin)), scene.colours)
    rows = []
    for k, frame in frames.items():
        truths = {"256": frames["256"], "1024": fine}
        against = {n: errors(frame.visibility[0][visible], f.visibility[0][visible]) for n, f in truths.items()}
        rows.append(
            {
                "scene": name,
                "triangles": scene.n_triangles,
                "size": options.size,
                "method": k,
                "rays": frame.rays,
                "trace_ms": 1e3 * statistics.median(t["trace"] for t in seconds[k]),
                "filter_ms": 1e3 * statistics.median(t["filter"] for t in seconds[k]),
                "total_ms": 1e3 * statistics.median(t["total"] for t in seconds[k]),
                **{f"visibility_{what}_{n}": v for n, e in against.items() for what, v in zip(("rms", "mean"), e)},
                "picture_rms": errors(pictures[k], pictures["truth"])[0],
                "refined": None if frame.refined is None else float(frame.refined.mean()),
                "edges": None if frame.refined is None else float(edge.mean()),
            }
        )
    if options.out:
        draw(name, options.out, pictures, frames, fine)
    return rows


def draw(name: str, folder: Path, pictures, frames, fine) -> None:
    """Write all pictures, the refined pixels, and crops side by side where the visibility of 16 samples is worst."""
    folder.mkdir(parents=True, exist_ok=True)
    for k, picture in pictures.items():
        Image.fromarray(picture).save(folder / f"{name}-{k.replace(' ', '-')}.png")
    marked = pictures["16"] // 2
    marked[frames["16 adaptive 64"].refined] |= np.array([128, 0, 0], np.uint8)
    Image.fromarray(marked).save(folder / f"{name}-refined.png")
    wrong = np.abs(frames["16"].visibility[0] - fine.visibility[0])
    n = len(wrong) // CROP
    sums = wrong[: n * CROP, : n * CROP].reshape(n, CROP, n, CROP).sum((1, 3))
    rows = []
    for block in np.argsort(sums, axis=None)[: -len(sums) : -1][:3]:
        y, x = CROP * (block // n), CROP * (block % n)
        crops = [pictures[k][y : y + CROP, x : x + CROP] for k in (*SHOWN, "truth")]
        rows.append(np.concatenate(crops, 1))
    sheet = np.concatenate(rows, 0).repeat(ZOOM, 0).repeat(ZOOM, 1)
    Image.fromarray(sheet).save(folder / f"{name}-crops.png")


def main() -> None:
    parser = arguments(__doc__)
    parser.set_defaults(rounds=3)
    parser.add_argument("--size", type=int, default=512)
    parser.add_argument("--out", type=Path, help="write pictures into this folder")
    options = parser.parse_args()
    names = [str(s) for s in options.scene] or [n for n in DEFAULT if n in DEFAULT[:2] or (SCENES / n).is_dir()]
    rows = []
    heads = "trace", "filter", "tot. ms", "rms 256", "mean", "rms1024", "mean", "picture", "refined", "edges"
    print(f"{'scene':14s} {'method':24s} {'Mrays':>6s} " + " ".join(f"{head:>7s}" for head in heads))
    for name in names:
        for r in measure(name, options):
            rows.append(r)
            shares = "" if r["refined"] is None else f"{100 * r['refined']:7.1f}% {100 * r['edges']:5.1f}%"
            e = " ".join(f"{1e3 * r[f'visibility_{k}']:7.1f}" for k in ("rms_256", "mean_256", "rms_1024", "mean_1024"))
            times = f"{r['trace_ms']:7.0f} {r['filter_ms']:7.0f} {r['total_ms']:7.0f}"
            print(f"{name:14s} {r['method']:24s} {r['rays'] / 1e6:6.1f} {times} {e} {r['picture_rms']:7.2f} {shares}")
    if options.json:
        options.json.write_text(json.dumps({"machine": machine(options.threads), "rows": rows}, indent=1))


if __name__ == "__main__":
    main()
