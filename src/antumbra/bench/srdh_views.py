"""What the benchmark of SRDH looks at: real scenes with area lights, and generated ones with much occlusion."""

import json
import os
import warnings
from pathlib import Path
from typing import NamedTuple

import numpy as np

from ..errors import InputError
from ..scene.camera import Camera
from ..scene.generated import procedural
from ..scene.lights import Light, QuadLight, tangents
from ..scene.load import load
from ..scene.procedural import PROCEDURAL
from ..scene.scene import Scene

REAL = ("sponza_crytek", "zdm2", "godot_room", "bart_robots", "sanmiguel_lite")
"""Folders of $ANTUMBRA_SCENES that are looked at where they are there, each a scene.glb and an info.json."""

MADE = tuple(name for name in ("blinds", "cellar", "atrium") if name in PROCEDURAL)
"""Of the procedural scenes the first is always looked at, the others where there is no real one."""

_DIAGONALS = {"bart_robots": 400.0}
"""What stands for the scene's diagonal where that makes no sense: the robots' city has a sky, twenty times as wide as
the street in which they and the lamp are. This is the diagonal of what the camera sees."""


class SrdhView(NamedTuple):
    """A scene as the benchmark sees it."""

    name: str
    scene: Scene
    camera: Camera
    lights: list[Light]


def default_names() -> list[str]:
    """What is looked at if nothing is named."""
    real = [name for name in REAL if _file(name) is not None]
    return [*real, MADE[0]] if real else list(MADE)


def named_view(name: str, size: tuple[int, int]) -> SrdhView:
    """The view of a folder of $ANTUMBRA_SCENES, of a procedural scene, or of a scene file."""
    path = _file(name)
    if path is None and name in PROCEDURAL:
        return own_view(name, procedural(name), size)
    if path is None:
        there = [*(real for real in REAL if _file(real) is not None), *PROCEDURAL]
        raise InputError(f"{name}: there is no such scene file, and no such scene; choose one of {', '.join(there)}")
    notes = path.with_name("info.json")
    info = json.loads(notes.read_text()) if notes.exists() else {}
    up = np.array(info.get("up", [0, 1, 0]), float)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)  # notes, which `antumbra info` shows
        scene = load(path, up="z" if up[2] else "y")
    view = own_view(name, scene, size)
    if "camera" in info:
        own = info["camera"]
        view = view._replace(camera=Camera(own["position"], own["target"], up, own["vfov"], *size))
    return view._replace(lights=[square(name, scene.bounds, info["light"], up, 10)]) if "light" in info else view


def own_view(name: str, scene: Scene, size: tuple[int, int]) -> SrdhView:
    """A scene with its own camera and lights, or the default ones."""
    camera = scene.cameras[0].resized(*size) if scene.cameras else scene.default_camera(*size)
    return SrdhView(name, scene, camera, scene.lights or [scene.default_light()])


def _file(name: str) -> Path | None:
    """The file of a real scene, by the name of its folder or its own."""
    folder = os.environ.get("ANTUMBRA_SCENES")
    path = Path(folder or ".") / name / "scene.glb"
    if folder and path.is_file():
        return path
    return Path(name) if name not in PROCEDURAL and Path(name).is_file() else None


def square(name: str, bounds: np.ndarray, light: list[float], up: np.ndarray, parts: int) -> QuadLight:
    """A square with the middle and direction of an info.json, its edge one of so many parts of the scene's diagonal.

    A point (three numbers) becomes a level square; a direction towards the light (a fourth, 0) a square that faces the
    scene, one diagonal away from its middle.
    """
    diagonal = float(np.linalg.norm(bounds[1] - bounds[0]))
    middle, facing = np.array(light[:3], float), up
    if len(light) == 4:
        facing = middle / np.linalg.norm(middle)
        middle = bounds.mean(0) + diagonal * facing
    u, v = (_DIAGONALS.get(name, diagonal) / parts * axis for axis in tangents(facing))
    return QuadLight(middle - (u + v) / 2, u, v)
