"""What benchmarks look at: a scene, a camera, lights; those that an info.json tells, or the scene's own.

An info.json lies beside a scene file, or in a folder of vertex frames. It has "up", "camera" (position, target, vfov in
degrees) and "light": a point, or the direction towards a distant light and a fourth number, 0.
"""

import json
import os
import warnings
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import NamedTuple

import numpy as np

from ..cli.arguments import PROCEDURAL as PREFIX
from ..cli.arguments import parse_scene
from ..cli.sceneinput import open_scene
from ..errors import InputError
from ..loading import load
from ..scene.any_scene import AnyScene
from ..scene.camera import Camera
from ..scene.generated import procedural
from ..scene.lights import Light, PointLight, QuadLight, tangents
from ..scene.procedural import PROCEDURAL

_DIAGONALS = {"bart_robots": 400.0}
"""What stands for the scene's diagonal where that makes no sense: the robots' city has a sky, twenty times as wide as
the street in which they and the lamp are. This is the diagonal of what the camera sees."""


class View(NamedTuple):
    """A scene as a benchmark sees it."""

    name: str
    scene: AnyScene
    camera: Camera
    lights: list[Light]


LightMaker = Callable[[str, np.ndarray, list[float], np.ndarray], Light]
"""Name and bounds of a scene, "light" and "up" of its info.json -> light: `point`, or `square` of some size."""


def real_path(name: str, part: str = "scene.glb") -> Path | None:
    """A file in a folder of $ANTUMBRA_SCENES; None if it is not there."""
    folder = os.environ.get("ANTUMBRA_SCENES")
    path = Path(folder or ".") / name / part
    return path if folder and path.is_file() else None


def file_of(name: str) -> Path | None:
    """The file of a scene, by the name of its folder or its own; None: there is none, or `name` is procedural."""
    here = Path(name) if name not in PROCEDURAL and Path(name).is_file() else None
    return real_path(name) or here


def named_view(name: str, size: tuple[int, int], make_light: LightMaker, real: tuple[str, ...] = ()) -> View:
    """The view of a folder of $ANTUMBRA_SCENES, of a procedural scene, or of a scene file; `real`: folders to name."""
    path = file_of(name)
    if path is not None:
        return told_view(name, path, size, make_light)
    if name in PROCEDURAL:
        return own_view(name, procedural(name), size)
    there = [*(folder for folder in real if real_path(folder)), *PROCEDURAL]
    raise InputError(f"{name}: there is no such scene file, and no such scene; choose one of {', '.join(there)}")


def told_view(name: str, path: Path, size: tuple[int, int], make_light: LightMaker) -> View:
    """The view of a scene file, or of a folder of vertex frames, with what its info.json tells."""
    info = read_info(path)
    up = np.array(info.get("up", [0, 1, 0]), float)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)  # notes, which `antumbra info` shows
        scene = load(path, up="z" if up[2] else "y")
    view = own_view(name, scene, size)
    if "camera" in info:
        own = info["camera"]
        view = view._replace(camera=Camera(own["position"], own["target"], up, own["vfov"], *size))
    return view._replace(lights=[make_light(name, scene.bounds, info["light"], up)]) if "light" in info else view


def own_view(name: str, scene: AnyScene, size: tuple[int, int]) -> View:
    """A scene with its own camera and lights, or the default ones."""
    camera = scene.cameras[0].resized(*size) if scene.cameras else scene.default_camera(*size)
    return View(name, scene, camera, scene.lights or [scene.default_light()])


def open_view(name: str, size: tuple[int, int], named_view: Callable[[str, tuple[int, int]], View]) -> View:
    """What a benchmark looks at: ``procedural:...`` as `open_scene` makes it, every other name by `named_view`."""
    spec = parse_scene(name)
    if spec.path is not None:
        return named_view(name, size)
    return own_view(name.removeprefix(PREFIX), open_scene(spec), size)


def read_info(path: Path) -> dict:
    """The info.json in a folder, or beside a file; empty if there is none."""
    notes = path / "info.json" if path.is_dir() else path.with_name("info.json")
    return json.loads(notes.read_text()) if notes.exists() else {}


def point(name: str, bounds: np.ndarray, light: list[float], up: np.ndarray) -> PointLight:
    """The light of an info.json as a point; of a direction, a point one diagonal of the scene away from its middle."""
    return PointLight(_middle(bounds, light, up)[0])


def square(parts: int) -> LightMaker:
    """The light of an info.json as a square around its middle, its edge one of so many parts of the scene's diagonal.

    A point becomes a level square; a direction a square that faces the scene, one diagonal away from its middle.
    """
    return partial(_square, parts)


def _square(parts: int, name: str, bounds: np.ndarray, light: list[float], up: np.ndarray) -> QuadLight:
    middle, facing = _middle(bounds, light, up)
    u, v = (_DIAGONALS.get(name, _diagonal(bounds)) / parts * axis for axis in tangents(facing))
    return QuadLight(middle - (u + v) / 2, u, v)


def _middle(bounds, light, up) -> tuple[np.ndarray, np.ndarray]:
    """Of the light of an info.json: (its middle, the unit direction that a square there faces or turns its back to)."""
    middle = np.array(light[:3], float)
    if len(light) < 4:
        return middle, up
    facing = middle / np.linalg.norm(middle)
    return bounds.mean(0) + _diagonal(bounds) * facing, facing


def _diagonal(bounds) -> float:
    return float(np.linalg.norm(bounds[1] - bounds[0]))
