"""Benchmark views (a scene with camera and lights), and digests that compare the answers of several methods.

An optional info.json lies beside a scene file, or in a folder of vertex frames. Its fields are "up", "camera"
(position, target, vfov in degrees) and "light": a point, or the direction towards a distant light followed by 0.
Without an info.json, the scene's own camera and lights are used.
"""

import json
import os
import warnings
from collections.abc import Callable, Iterable
from functools import partial
from hashlib import sha256
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from ...base.errors import InputError
from ...cli.scene_arguments import open_scene, parse_scene
from ...engine.scene import AnyScene, procedural
from ...engine.scene_loading import load
from ...formats.example_files import PROCEDURAL_PREFIX
from ...generate.procedural_scenes import PROCEDURAL, load_plugin_scenes
from ...scene.camera import Camera
from ...scene.lights import Light, PointLight, QuadLight, tangents

# --- Digests of answers -----------------------------------------------------------------------------------------------


def digest(bits: Iterable[np.ndarray]) -> bytes:
    """The SHA-256 digest of the bits of all lights."""
    return sha256(b"".join(b.tobytes() for b in bits)).digest()


def agree(answers: Iterable[tuple[str, bytes]]) -> bool:
    """Whether all methods answer every query alike. `answers` has the (query, digest) of each answer."""
    first: dict[str, bytes] = {}
    return all(first.setdefault(query, bits) == bits for query, bits in answers)


# --- Benchmark views --------------------------------------------------------------------------------------------------


_DIAGONALS = {"bart_robots": 400.0}
"""Scene -> the diagonal to use instead of the scene's own.

The sky of the robots' city is twenty times as wide as the street with the robots and the lamp, so the diagonal of the
part in the camera's view replaces it."""


class BenchmarkView(NamedTuple):
    """A scene with the camera and lights of a benchmark."""

    name: str
    scene: AnyScene
    camera: Camera
    lights: list[Light]


LightMaker = Callable[[str, np.ndarray, list[float], np.ndarray], Light]
"""Makes a light from a scene's name, bounds, and the "light" and "up" of its info.json: `point`, or what `square`
returns."""


def real_path(name: str, part: str = "scene.glb") -> Path | None:
    """The path of a file in folder `name` of $ANTUMBRA_SCENES; None if there is no such file."""
    folder = os.environ.get("ANTUMBRA_SCENES")
    path = Path(folder or ".") / name / part
    return path if folder and path.is_file() else None


def file_of(name: str) -> Path | None:
    """The scene file of a folder of $ANTUMBRA_SCENES or a path; None if there is none, or for a procedural scene."""
    load_plugin_scenes()
    here = Path(name) if name not in PROCEDURAL and Path(name).is_file() else None
    return real_path(name) or here


class BenchmarkScenes(NamedTuple):
    """The scenes of a benchmark, with lights of one kind."""

    real: tuple[str, ...]  # folders of $ANTUMBRA_SCENES to measure if they exist
    beside_real: tuple[str, ...]  # procedural scenes to measure beside them
    without_real: tuple[str, ...]  # procedural scenes to measure if none of the folders exists
    make_light: LightMaker  # makes the light of a scene with an info.json
    moving: tuple[str, ...] = ()  # the folders with vertex frames

    def default_names(self) -> list[str]:
        """The names of the default scenes."""
        real = [name for name in self.real if real_path(name, "frames.npy" if name in self.moving else "scene.glb")]
        return [*real, *self.beside_real] if real else list(self.without_real)

    def view(self, name: str, size: tuple[int, int]) -> BenchmarkView:
        """The view of a folder of $ANTUMBRA_SCENES, a procedural scene, a scene file, or a folder of vertex frames.

        Raises
        ------
        InputError
            If there is no such scene.
        """
        spec = parse_scene(name)
        if spec.path is None:
            return scene_view(name.removeprefix(PROCEDURAL_PREFIX), open_scene(spec), size)
        frames = real_path(name, "frames.npy") if name in self.moving else Path(name) / "frames.npy"
        if frames and frames.is_file():
            return info_view(frames.parent.resolve().name, frames.parent, size, self.make_light)
        path = file_of(name)
        if path is not None:
            return info_view(name, path, size, self.make_light)
        if name in PROCEDURAL:
            return scene_view(name, procedural(name), size)
        available = [*(folder for folder in self.real if real_path(folder)), *PROCEDURAL]
        raise InputError(f"{name}: no such scene or scene file; choose one of {', '.join(available)}")

    def open(
        self, names: Iterable[str] | None, size: tuple[int, int], say: Callable[[str], None]
    ) -> list[BenchmarkView]:
        """The views of distinct names, or of the default scenes."""
        say("opening the scenes")
        return [self.view(name, size) for name in dict.fromkeys(names or self.default_names())]


def info_view(name: str, path: Path, size: tuple[int, int], make_light: LightMaker) -> BenchmarkView:
    """The view of a scene file, or of a folder of vertex frames, with the camera and light of its info.json."""
    info = read_info(path)
    up = np.array(info.get("up", [0, 1, 0]), float)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)  # `antumbra info` shows these notes
        scene = load(path, up="z" if up[2] else "y")
    view = scene_view(name, scene, size)
    if "camera" in info:
        camera = info["camera"]
        view = view._replace(camera=Camera(camera["position"], camera["target"], up, camera["vfov"], *size))
    return view._replace(lights=[make_light(name, scene.bounds, info["light"], up)]) if "light" in info else view


def scene_view(name: str, scene: AnyScene, size: tuple[int, int]) -> BenchmarkView:
    """The view of a scene through its own camera and with its own lights, or the default ones."""
    camera = scene.cameras[0].resized(*size) if scene.cameras else scene.default_camera(*size)
    return BenchmarkView(name, scene, camera, scene.lights or [scene.default_light()])


def read_info(path: Path) -> dict[str, Any]:
    """The fields of the info.json in a folder or beside a file; empty if there is none."""
    file = path / "info.json" if path.is_dir() else path.with_name("info.json")
    info: dict[str, Any] = json.loads(file.read_text()) if file.exists() else {}
    return info


def point(name: str, bounds: np.ndarray, light: list[float], up: np.ndarray) -> PointLight:
    """The light of an info.json as a point light.

    A direction becomes a point one scene diagonal away from the scene's centre.
    """
    return PointLight(_middle(bounds, light, up)[0])


def square(parts: int) -> LightMaker:
    """A `LightMaker` of square lights with edges of 1 / `parts` of the scene's diagonal.

    A point becomes a horizontal square around it; a direction becomes a square that faces the scene, one diagonal away
    from its centre.
    """
    return partial(_square, parts)


def _square(parts: int, name: str, bounds: np.ndarray, light: list[float], up: np.ndarray) -> QuadLight:
    middle, facing = _middle(bounds, light, up)
    u, v = (diagonal_of(name, bounds) / parts * axis for axis in tangents(facing))
    return QuadLight(middle - (u + v) / 2, u, v)


def diagonal_of(name: str, bounds: np.ndarray) -> float:
    """The diagonal of a scene, or of the part in its camera's view; it sets the size of the light."""
    return _DIAGONALS.get(name, _diagonal(bounds))


def _middle(bounds: np.ndarray, light: list[float], up: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(centre, unit normal) of a square at the light of an info.json."""
    middle = np.array(light[:3], float)
    if len(light) < 4:
        return middle, up
    facing = middle / np.linalg.norm(middle)
    return bounds.mean(0) + _diagonal(bounds) * facing, facing


def _diagonal(bounds: np.ndarray) -> float:
    return float(np.linalg.norm(bounds[1] - bounds[0]))
