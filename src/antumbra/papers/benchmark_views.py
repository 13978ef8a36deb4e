"""Views of the benchmarks: a scene, a camera and lights; and digests that compare the answers of several methods.

An info.json lies beside a scene file, or in a folder of vertex frames. Its fields are "up", "camera" (position, target,
vfov in degrees) and "light". A light is a point, or the direction towards a distant light followed by 0. Without an
info.json, the scene's own camera and lights are used.
"""

import json
import os
import warnings
from collections.abc import Callable, Iterable
from functools import partial
from hashlib import sha256
from pathlib import Path
from typing import NamedTuple

import numpy as np

from ..cli.arguments import PROCEDURAL as PREFIX
from ..cli.arguments import open_scene, parse_scene
from ..engine.scene import AnyScene, procedural
from ..engine.scene_loading import load
from ..errors import InputError
from ..generate.procedural_scenes import PROCEDURAL, add_scenes
from ..scene.camera import Camera
from ..scene.lights import Light, PointLight, QuadLight, tangents

# --- Compares the answers of several methods to the same question by their digests ------------------------------------


def digest(bits: Iterable[np.ndarray]) -> bytes:
    """The SHA-256 digest of the bits of all lights."""
    return sha256(b"".join(b.tobytes() for b in bits)).digest()


def agree(found: Iterable[tuple[str, bytes]]) -> bool:
    """Whether all answers to each question are the same. `found` holds (question, digest) of every answer."""
    answers: dict[str, bytes] = {}
    return all(answers.setdefault(question, bits) == bits for question, bits in found)


# ---------------------------------------------------------------------------------------------------------------------
# Views of the benchmarks: a scene, a camera and lights. An info.json gives camera and light, or the scene does.
#
# An info.json lies beside a scene file, or in a folder of vertex frames. Its fields are "up", "camera" (position,
# target, vfov in degrees) and "light". A light is a point, or the direction towards a distant light and a fourth
# number, 0.


_DIAGONALS = {"bart_robots": 400.0}
"""Scene -> the diagonal to use instead of the scene's own. The sky of the robots' city is twenty times as wide as the
street with the robots and the lamp. So this is the diagonal of the part that the camera sees."""


class BenchmarkView(NamedTuple):
    """A scene with the camera and the lights of a benchmark."""

    name: str
    scene: AnyScene
    camera: Camera
    lights: list[Light]


LightMaker = Callable[[str, np.ndarray, list[float], np.ndarray], Light]
"""Makes a light from a scene's name, its bounds, and "light" and "up" of its info.json: `point`, or from `square`."""


def real_path(name: str, part: str = "scene.glb") -> Path | None:
    """The path of a file in folder `name` of $ANTUMBRA_SCENES; None if there is no such file."""
    folder = os.environ.get("ANTUMBRA_SCENES")
    path = Path(folder or ".") / name / part
    return path if folder and path.is_file() else None


def file_of(name: str) -> Path | None:
    """The file of a scene, by the name of its folder or of the file; None if there is none, or if it is procedural."""
    add_scenes()
    here = Path(name) if name not in PROCEDURAL and Path(name).is_file() else None
    return real_path(name) or here


def named_view(name: str, size: tuple[int, int], make_light: LightMaker, real: tuple[str, ...] = ()) -> BenchmarkView:
    """The view of a folder of $ANTUMBRA_SCENES, of a procedural scene, or of a scene file.

    `real` : folders of $ANTUMBRA_SCENES that an error message suggests
    """
    path = file_of(name)
    if path is not None:
        return info_view(name, path, size, make_light)
    if name in PROCEDURAL:
        return scene_view(name, procedural(name), size)
    there = [*(folder for folder in real if real_path(folder)), *PROCEDURAL]
    raise InputError(f"{name}: there is no such scene file, and no such scene; choose one of {', '.join(there)}")


def info_view(name: str, path: Path, size: tuple[int, int], make_light: LightMaker) -> BenchmarkView:
    """The view of a scene file, or of a folder of vertex frames, with the camera and light of its info.json."""
    info = read_info(path)
    up = np.array(info.get("up", [0, 1, 0]), float)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)  # `antumbra info` shows these notes
        scene = load(path, up="z" if up[2] else "y")
    view = scene_view(name, scene, size)
    if "camera" in info:
        own = info["camera"]
        view = view._replace(camera=Camera(own["position"], own["target"], up, own["vfov"], *size))
    return view._replace(lights=[make_light(name, scene.bounds, info["light"], up)]) if "light" in info else view


def scene_view(name: str, scene: AnyScene, size: tuple[int, int]) -> BenchmarkView:
    """The view of a scene with its own camera and lights, or with the default ones."""
    camera = scene.cameras[0].resized(*size) if scene.cameras else scene.default_camera(*size)
    return BenchmarkView(name, scene, camera, scene.lights or [scene.default_light()])


def open_view(
    name: str, size: tuple[int, int], named_view: Callable[[str, tuple[int, int]], BenchmarkView]
) -> BenchmarkView:
    """The view of a name. `open_scene` makes ``procedural:...``; `named_view` makes the view of any other name."""
    spec = parse_scene(name)
    if spec.path is not None:
        return named_view(name, size)
    return scene_view(name.removeprefix(PREFIX), open_scene(spec), size)


def read_info(path: Path) -> dict:
    """The fields of the info.json in a folder, or beside a file; empty if there is none."""
    notes = path / "info.json" if path.is_dir() else path.with_name("info.json")
    return json.loads(notes.read_text()) if notes.exists() else {}


def point(name: str, bounds: np.ndarray, light: list[float], up: np.ndarray) -> PointLight:
    """The light of an info.json as a point light.

    A direction becomes a point one diagonal of the scene away from the scene's centre.
    """
    return PointLight(_middle(bounds, light, up)[0])


def square(parts: int) -> LightMaker:
    """A `LightMaker` of squares whose edge is 1 / `parts` of the scene's diagonal.

    A point becomes a level square around it. A direction becomes a square that faces the scene, one diagonal away from
    the scene's centre.
    """
    return partial(_square, parts)


def _square(parts: int, name: str, bounds: np.ndarray, light: list[float], up: np.ndarray) -> QuadLight:
    middle, facing = _middle(bounds, light, up)
    u, v = (diagonal_of(name, bounds) / parts * axis for axis in tangents(facing))
    return QuadLight(middle - (u + v) / 2, u, v)


def diagonal_of(name: str, bounds: np.ndarray) -> float:
    """The diagonal of a scene, or of the part that its camera sees, which sets the size of its light."""
    return _DIAGONALS.get(name, _diagonal(bounds))


def _middle(bounds, light, up) -> tuple[np.ndarray, np.ndarray]:
    """(centre, unit normal) of a square at the light of an info.json."""
    middle = np.array(light[:3], float)
    if len(light) < 4:
        return middle, up
    facing = middle / np.linalg.norm(middle)
    return bounds.mean(0) + _diagonal(bounds) * facing, facing


def _diagonal(bounds) -> float:
    return float(np.linalg.norm(bounds[1] - bounds[0]))
