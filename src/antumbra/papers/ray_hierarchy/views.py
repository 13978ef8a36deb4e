"""What the benchmark of ray hierarchies looks at: BART's robots in motion, its museum from four places, still scenes.

One point light shines in each picture.
"""

from pathlib import Path
from typing import NamedTuple

import numpy as np

from ...scene.camera import Camera
from ...scene.lights import Light, PointLight
from ...scene.scene import Scene
from .. import views
from ..views import View, point, real_path, told_view

ROBOTS, MUSEUM = "bart_robots", "bart_museum8_subdivided"
MOVING = (ROBOTS, MUSEUM)
"""Folders of $ANTUMBRA_SCENES whose vertex frames are looked at; of all others it is the still scene.glb."""

REAL = (*MOVING, "sponza_crytek", "synthetic_garden_foxes")
MADE = ("atrium", "forest")
"""Procedural scenes that are looked at where no real one is there. Neither moves."""

_MUSEUM = {
    "hall": (1.0, None),
    "before the cloud": (2.0, ((-0.9, 2.6, 1.0), (0.5, 2.4, -0.6), 70.0)),
    "wall": (1.0, ((1.8, 1.8, 1.2), (5.0, 1.6, -0.8), 60.0)),
    "in the cloud": (1.75, ((-0.6, 2.7, 0.6), (0.5, 2.4, -0.6), 75.0)),
}
"""In the order of Table 2: seconds, and position, target and vfov (None: those of info.json). The first and the third
see large surfaces, the others the far wall between hundreds of small triangles that hang in the air."""


class Picture(NamedTuple):
    """A scene at one moment."""

    name: str
    of: str  # the scene's name
    frame: int | None  # number within an animation; None: it is looked at once, or from another place each time
    scene: Scene
    camera: Camera
    light: Light
    time: float  # seconds


def default_names() -> list[str]:
    """What is looked at if nothing is named."""
    real = [name for name in REAL if real_path(name, "frames.npy" if name in MOVING else "scene.glb")]
    return real or list(MADE)


def named_view(name: str, size: tuple[int, int]) -> View:
    """The view of a folder of $ANTUMBRA_SCENES, of a procedural scene, of a scene file or a folder of vertex frames."""
    frames = real_path(name, "frames.npy") if name in MOVING else Path(name) / "frames.npy"
    if frames and frames.is_file():
        return told_view(frames.parent.resolve().name, frames.parent, size, point)
    return views.named_view(name, size, point, REAL)


def with_point(view: View) -> View:
    """The view with a point in the middle of its first light as its only light."""
    light, bounds = view.lights[0], view.scene.bounds
    patch = light.patch(view.scene.origin, float(np.linalg.norm(bounds[1] - bounds[0])))
    middle = patch.base + (patch.u + patch.v) / 2 if light.domain == "square" else patch.base
    return view._replace(lights=[PointLight(view.scene.origin + middle)])


def times_of(scene: Scene, frames: int) -> list[float]:
    """So many moments, spread evenly through the animation; one of a scene that does not move."""
    return np.linspace(0.0, scene.duration, frames).tolist() if scene.animated else [0.0]


def pictures(view: View, frames: int) -> list[Picture]:
    """The museum from four places, other scenes that move in so many frames, and still ones once."""
    name, scene, camera, (light, *_) = view
    if name == MUSEUM:
        return [
            Picture(f"museum, {place}", name, None, scene, _placed(camera, where), light, time)
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
