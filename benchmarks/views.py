"""Views of the benchmarks: real scenes with the camera and light of their info.json, and the procedural forest."""

import sys
from pathlib import Path
from typing import NamedTuple

import antumbra
from antumbra.lab.papers.benchmark_views import info_view, square
from antumbra.scene.camera import Camera
from antumbra.scene.lights import Light, QuadLight
from antumbra.scene.triangles import Triangles
from common import SCENES

FOREST = "forest"
VIEWS = ("sponza_crytek", "sanmiguel_lite", "bart_robots", FOREST)

MOVING = ("bart_robots", "synthetic_garden_foxes")


class View(NamedTuple):
    """A scene with the camera and lights of a benchmark."""

    name: str
    triangles: Triangles
    camera: Camera
    lights: dict[str, Light]  # "small", and "large" with four times the edge


class Moving(NamedTuple):
    """An animated scene with the camera and light of a benchmark."""

    name: str
    scene: antumbra.Scene
    camera: Camera
    light: QuadLight  # the small light


def views(named, size: tuple[int, int]):
    """Yield the views of names in VIEWS or of scene files; without names, all of VIEWS that exist."""
    missing = [n for n in VIEWS if n != FOREST and not (SCENES / n / "scene.glb").exists()]
    if missing and not named:
        print(f"skipped, not in {SCENES}: {', '.join(missing)}", file=sys.stderr)
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
    """Yield the animated scenes of names in MOVING, files or folders; without names, all of MOVING that exist."""
    missing = [n for n in MOVING if not (SCENES / n / "frames.npy").exists()]
    if missing and not named:
        print(f"skipped, not in {SCENES}: {', '.join(missing)}", file=sys.stderr)
    for name in named or [n for n in MOVING if n not in missing]:
        if name in missing:
            sys.exit(f"{name} is not in {SCENES}: set ANTUMBRA_SCENES")
        path = SCENES / name if name in MOVING else Path(name)
        view = info_view(path.stem, path, size, square(40))
        yield Moving(view.name, view.scene, view.camera, view.lights[0])


def _real(path: Path, size) -> View:
    view = info_view(path.parent.name if path.stem == "scene" else path.stem, path, size, square(40))
    light = view.lights[0] if isinstance(view.lights[0], QuadLight) else view.scene.default_light()
    return View(view.name, view.scene.triangles(0.0), view.camera, _two_sizes(light))


def _two_sizes(light: QuadLight) -> dict[str, Light]:
    middle = light.corner + (light.u + light.v) / 2
    return {"small": light, "large": QuadLight(middle - 2 * (light.u + light.v), 4 * light.u, 4 * light.v)}
