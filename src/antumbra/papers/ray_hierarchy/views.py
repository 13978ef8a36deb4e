"""Views of the ray hierarchy benchmark: BART's robots in motion, its museum from four places, and still scenes.

BART's own camera walks through the robots' city, and the report follows it. Here the camera of the robots stands still,
because their folder has no camera path. Each picture has one point light.
"""

from pathlib import Path
from typing import NamedTuple

import numpy as np

from ...engine.scene import Scene
from ...scene.camera import Camera
from ...scene.lights import Light, PointLight
from .. import views
from ..views import View, point, real_path, told_view

ROBOTS, MUSEUM = "bart_robots", "bart_museum8_subdivided"
MOVING = (ROBOTS, MUSEUM)
"""Folders of $ANTUMBRA_SCENES whose vertex frames are used. All other folders give their still scene.glb."""

REAL = (*MOVING, "sponza_crytek", "synthetic_garden_foxes")
MADE = ("atrium", "forest")
"""Procedural scenes for machines without the real ones. Neither moves."""

MUSEUM_NAME = "subdivided museum"
"""The report has BART's museum at its finest tessellation. This one is a coarse one with its triangles subdivided."""

STILL_CAMERA = "The robots are seen by a camera that stands still: their folder has no camera path"

_MUSEUM = {
    "hall": (1.0, None),
    "before the cloud": (2.0, ((-0.9, 2.6, 1.0), (0.5, 2.4, -0.6), 70.0)),
    "wall": (1.0, ((1.8, 1.8, 1.2), (5.0, 1.6, -0.8), 60.0)),
    "in the cloud": (1.75, ((-0.6, 2.7, 0.6), (0.5, 2.4, -0.6), 75.0)),
}
"""Place -> (seconds, (position, target, vfov) of the camera, None: from info.json), in the order of Table 2. The first
and the third see large surfaces. The others see the far wall between hundreds of small triangles that hang in the air.
"""


class Picture(NamedTuple):
    """A scene at one moment."""

    name: str
    of: str  # name of the scene
    frame: int | None  # number within an animation; None: the scene is still, or each picture has another camera
    scene: Scene
    camera: Camera
    light: Light
    time: float  # seconds


def default_names() -> list[str]:
    """The scenes that are measured if none is named."""
    real = [name for name in REAL if real_path(name, "frames.npy" if name in MOVING else "scene.glb")]
    return real or list(MADE)


def named_view(name: str, size: tuple[int, int]) -> View:
    """The view of a folder of $ANTUMBRA_SCENES, a procedural scene, a scene file, or a folder of vertex frames."""
    frames = real_path(name, "frames.npy") if name in MOVING else Path(name) / "frames.npy"
    if frames and frames.is_file():
        return told_view(frames.parent.resolve().name, frames.parent, size, point)
    return views.named_view(name, size, point, REAL)


def with_point(view: View) -> View:
    """The view with a single light: a point in the centre of its first light."""
    light, bounds = view.lights[0], view.scene.bounds
    patch = light.patch(view.scene.origin, float(np.linalg.norm(bounds[1] - bounds[0])))
    middle = patch.base + (patch.u + patch.v) / 2 if light.domain == "square" else patch.base
    return view._replace(lights=[PointLight(view.scene.origin + middle)])


def times_of(scene: Scene, frames: int) -> list[float]:
    """`frames` times, spread evenly over the animation; a single time for a still scene."""
    return np.linspace(0.0, scene.duration, frames).tolist() if scene.animated else [0.0]


def pictures(view: View, frames: int) -> list[Picture]:
    """The pictures of a view: the museum from four places, another animation in `frames` frames, a still scene once."""
    name, scene, camera, (light, *_) = view
    if name == MUSEUM:
        return [
            Picture(f"{MUSEUM_NAME}, {place}", name, None, scene, _placed(camera, where), light, time)
            for place, (time, where) in _MUSEUM.items()
        ]
    if not scene.animated:
        return [Picture(name, name, None, scene, camera, light, 0.0)]
    times = times_of(scene, frames)
    return [Picture(f"{name}, {t:.2f} s", name, k, scene, camera, light, t) for k, t in enumerate(times)]


def _placed(camera: Camera, where) -> Camera:
    if where is None:
        return camera
    position, target, vfov = where
    return Camera(position, target, camera.up, vfov, camera.width, camera.height)
