"""What benchmarks look at: the real scenes with the camera and light of their info.json, and the generated forest."""

import json
import sys
from pathlib import Path
from typing import NamedTuple

import numpy as np

import antumbra
from antumbra.bench.srdh_views import square
from antumbra.query.gbuffer import from_hits
from antumbra.query.picture import shadow_queries
from antumbra.query.raster import rasterise
from antumbra.query.sampling import light_samples
from antumbra.scene.camera import Camera
from antumbra.scene.lights import Light, QuadLight
from antumbra.scene.triangles import Triangles
from common import SCENES

FOREST = "forest"
VIEWS = ("sponza_crytek", "sanmiguel_lite", "bart_robots", FOREST)

MOVING = ("bart_robots", "synthetic_garden_foxes")


class View(NamedTuple):
    """A scene as a benchmark sees it."""

    name: str
    triangles: Triangles
    camera: Camera
    lights: dict[str, Light]  # "small", and "large" with four times the edge


class Moving(NamedTuple):
    """A moving scene as a benchmark sees it."""

    name: str
    scene: antumbra.Scene
    camera: Camera
    light: QuadLight  # the small one


def views(named, size: tuple[int, int]):
    """Each view: names of VIEWS, or scene files; none: all of VIEWS that are there."""
    missing = [n for n in VIEWS if n != FOREST and not (SCENES / n / "scene.glb").exists()]
    if missing and not named:
        print(f"not in {SCENES}, so left out: {', '.join(missing)}", file=sys.stderr)
    for name in named or [n for n in VIEWS if n not in missing]:
        name = str(name)
        if name == FOREST:
            yield _forest(size)
        elif name in missing:
            sys.exit(f"{name} is not in {SCENES}: set ANTUMBRA_SCENES")
        else:
            yield _real(SCENES / name / "scene.glb" if name in VIEWS else Path(name), size)


def _forest(size) -> View:
    scene = antumbra.procedural(FOREST)
    return View(FOREST, scene.triangles(0.0), scene.cameras[0].resized(*size), _two_sizes(scene.light(0)))


def moving_views(named, size: tuple[int, int]):
    """Each moving scene: names of MOVING, or files or folders; none: all of MOVING that are there."""
    missing = [n for n in MOVING if not (SCENES / n / "frames.npy").exists()]
    if missing and not named:
        print(f"not in {SCENES}, so left out: {', '.join(missing)}", file=sys.stderr)
    for name in named or [n for n in MOVING if n not in missing]:
        if name in missing:
            sys.exit(f"{name} is not in {SCENES}: set ANTUMBRA_SCENES")
        path = SCENES / name if name in MOVING else Path(name)
        info = _info(path / "info.json")
        scene = antumbra.load(path, up=_up(info))
        yield Moving(path.stem, scene, *_camera_and_light(path.stem, scene, info, size))


def _info(path: Path) -> dict:
    return json.loads(path.read_text()) if path.exists() else {}


def _up(info: dict) -> str:
    return "z" if info.get("up", [0, 1, 0])[2] else "y"


def _real(path: Path, size) -> View:
    info = _info(path.with_name("info.json"))
    scene = antumbra.load(path, up=_up(info))
    name = path.parent.name if path.stem == "scene" else path.stem
    camera, light = _camera_and_light(name, scene, info, size)
    return View(name, scene.triangles(0.0), camera, _two_sizes(light))


def _camera_and_light(name: str, scene, info: dict, size) -> tuple[Camera, QuadLight]:
    """Those of info.json, or the scene's own defaults."""
    up = np.array(info.get("up", [0, 1, 0]), float)
    if "camera" in info:
        own = info["camera"]
        camera = Camera(own["position"], own["target"], up, own["vfov"], *size)
    else:
        camera = scene.default_camera(*size)
    return camera, square(name, scene.bounds, info["light"], up, 40) if "light" in info else scene.default_light()


def _two_sizes(light: QuadLight) -> dict[str, Light]:
    middle = light.corner + (light.u + light.v) / 2
    return {"small": light, "large": QuadLight(middle - 2 * (light.u + light.v), 4 * light.u, 4 * light.v)}


def query_of(view: View, light: Light, spp: int, threads: int):
    """The shadow query of what a view's camera sees."""
    rays = view.camera.rays(view.triangles.origin)
    hits = rasterise(view.triangles.vertices.reshape(-1, 9), rays, threads)
    gbuffer = from_hits(*hits, view.triangles, rays, threads)
    return shadow_queries(view.triangles, gbuffer, [light], [light_samples(light, spp)], threads=threads)[0]
