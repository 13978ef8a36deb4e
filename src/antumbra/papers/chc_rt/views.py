"""Walkthroughs of the CHC+RT benchmark [Mattausch et al. 2015, Sec. 7].

The city has a walk along a street and a bird's eye view. Any other scene has a few steps from its own camera, and a
view of the whole scene from afar.
"""

from typing import NamedTuple

import numpy as np

from ...engine.paged_scene import PagedScene
from ...engine.scene import AnyScene
from ...errors import InputError
from ...generate.city import PITCH
from ...scene.camera import Camera
from ...scene.lights import Light
from .. import views
from ..views import View, real_path, square

REAL = ("sanmiguel_lite",)
"""Folders of $ANTUMBRA_SCENES that are measured if they exist."""

CITY = "procedural:city?triangles="
_EYE = 1.7  # height of the eye above the street, in metres
_LANE = 1.5  # distance from the middle of the street, in metres; there are no cars here
_FIRST, _LAST = 55.0, -5.0  # z of both ends of the walk along the street
_CITY_REACH, _REACH = 2.0, 1 / 200  # length of AO rays: in metres, or as a share of the scene's diagonal
_STEP = 1 / 100  # length of a walk from a camera, as a share of the diagonal
_TURN = np.radians(15.0)
_NEARER = 0.6  # share of the distance from which the whole bounding sphere is visible: most scenes are flat


class Walk(NamedTuple):
    """A walkthrough along a straight line."""

    name: str  # "near" or "far"
    first: Camera
    last: Camera

    def camera(self, frame: int, frames: int) -> Camera:
        """The camera of frame `frame` of `frames`."""
        share = frame / max(frames - 1, 1)
        a, b = self.first, self.last
        position, target = ((1.0 - share) * getattr(a, k) + share * getattr(b, k) for k in ("position", "target"))
        return Camera(position, target, a.up, a.vfov, a.width, a.height)


class WalkPlace(NamedTuple):
    """A scene and its walkthroughs."""

    name: str
    scene: AnyScene
    light: Light
    reach: float  # radius of ambient occlusion, in world units
    walks: tuple[Walk, Walk]  # near and far


def default_names(triangles: int) -> list[str]:
    """The scenes that are measured if none is named."""
    return [f"{CITY}{triangles}", *(name for name in REAL if real_path(name))]


def named_view(name: str, size: tuple[int, int]) -> View:
    """The view of a folder of $ANTUMBRA_SCENES, a procedural scene, a scene file or a store."""
    return views.named_view(name, size, square(10), REAL)


def check_in_memory(view: View) -> None:
    """Raise an InputError if the scene is in a store."""
    if isinstance(view.scene, PagedScene):
        raise InputError(f"{view.name}: is a store; name it with --store instead of --scene")


def place_of(view: View) -> WalkPlace:
    """A scene with its two walks."""
    scene, size = view.scene, (view.camera.width, view.camera.height)
    city = scene.name == "city"
    diagonal = float(np.linalg.norm(scene.bounds[1] - scene.bounds[0]))
    near = _street(scene, size) if city else _steps(view.camera, _STEP * diagonal)
    far = _nearer(scene.default_camera(*size))
    reach = _CITY_REACH if city else _REACH * diagonal
    walks = Walk("near", *near), Walk("far", far, _turned(far, far.target))
    return WalkPlace(view.name, scene, view.lights[0], reach, walks)


def _street(scene: AnyScene, size: tuple[int, int]) -> tuple[Camera, Camera]:
    """The first and the last camera along the street that is nearest to the centre of the city."""
    low, high = scene.bounds
    blocks = round(float(high[0] - low[0]) / PITCH)
    x = _LANE + (PITCH / 2 if blocks % 2 else 0.0)
    places = ((x, _EYE, z) for z in (_FIRST, _LAST))
    first, last = (Camera(p, np.add(p, (0.0, 0.5, -20.0)), vfov=60.0, width=size[0], height=size[1]) for p in places)
    return first, last


def _steps(camera: Camera, length: float) -> tuple[Camera, Camera]:
    """The camera, and the camera after a step ahead and a turn to the side."""
    ahead = camera.target - camera.position
    step = length / np.linalg.norm(ahead) * ahead
    position = camera.position + step
    target = _around(camera.target + step, position, camera.up)
    return camera, Camera(position, target, camera.up, camera.vfov, camera.width, camera.height)


def _nearer(camera: Camera) -> Camera:
    """The camera, moved nearer to its target."""
    position = camera.target + _NEARER * (camera.position - camera.target)
    return Camera(position, camera.target, camera.up, camera.vfov, camera.width, camera.height)


def _turned(camera: Camera, centre) -> Camera:
    """The camera after it has flown a part of a circle around `centre`."""
    position = _around(camera.position, centre, camera.up)
    return Camera(position, camera.target, camera.up, camera.vfov, camera.width, camera.height)


def _around(point, centre, up) -> np.ndarray:
    """A point, rotated around the axis `up` through `centre`."""
    axis, v = up / np.linalg.norm(up), point - centre
    along = np.dot(v, axis) * axis
    return centre + along + np.cos(_TURN) * (v - along) + np.sin(_TURN) * np.cross(axis, v)
