"""What the benchmark of CHC+RT walks through: a street and a bird's eye view of the city; of other scenes a few steps
from their own camera, and all of them from afar [Mattausch et al. 2015, Sec. 7].
"""

from typing import NamedTuple

import numpy as np

from ...errors import InputError
from ...scene.any_scene import AnyScene
from ...scene.camera import Camera
from ...scene.lights import Light
from ...scene.procedural.city import PITCH
from ...store.scene import PagedScene
from .. import views
from ..views import View, real_path, square

REAL = ("sanmiguel_lite",)
"""Folders of $ANTUMBRA_SCENES that are walked through where they are there."""

CITY = "procedural:city?triangles="
_EYE = 1.7  # metres above the street
_LANE = 1.5  # beside its middle, where no cars are
_FIRST, _LAST = 55.0, -5.0  # of the way along the street
_CITY_REACH, _REACH = 2.0, 1 / 200  # how far AO rays go: metres, or of the scene's diagonal
_STEP = 1 / 100  # of the diagonal, for a walk from a camera
_TURN = np.radians(15.0)
_NEARER = 0.6  # of the distance from which all of a scene's bounding sphere is seen: most scenes are flat


class Walk(NamedTuple):
    """A walkthrough: straight from one place to another."""

    name: str  # "near" or "far"
    first: Camera
    last: Camera

    def camera(self, frame: int, frames: int) -> Camera:
        """That of one of so many frames."""
        share = frame / max(frames - 1, 1)
        a, b = self.first, self.last
        position, target = ((1.0 - share) * getattr(a, k) + share * getattr(b, k) for k in ("position", "target"))
        return Camera(position, target, a.up, a.vfov, a.width, a.height)


class Place(NamedTuple):
    """A scene, and how it is walked through."""

    name: str
    scene: AnyScene
    light: Light
    reach: float  # of ambient occlusion, world units
    walks: tuple[Walk, Walk]  # near and far


def default_names(triangles: int) -> list[str]:
    """What is walked through if nothing is named."""
    return [f"{CITY}{triangles}", *(name for name in REAL if real_path(name))]


def named_view(name: str, size: tuple[int, int]) -> View:
    """The view of a folder of $ANTUMBRA_SCENES, of a procedural scene, of a scene file or of a store."""
    return views.named_view(name, size, square(10), REAL)


def check_in_memory(view: View) -> None:
    """InputError if the scene is in a store."""
    if isinstance(view.scene, PagedScene):
        raise InputError(f"{view.name}: is a store; name it with --store instead of --scene")


def place_of(view: View) -> Place:
    """A scene with its two walks."""
    scene, size = view.scene, (view.camera.width, view.camera.height)
    city = scene.name == "city"
    diagonal = float(np.linalg.norm(scene.bounds[1] - scene.bounds[0]))
    near = _street(scene, size) if city else _steps(view.camera, _STEP * diagonal)
    far = _nearer(scene.default_camera(*size))
    reach = _CITY_REACH if city else _REACH * diagonal
    walks = Walk("near", *near), Walk("far", far, _turned(far, far.target))
    return Place(view.name, scene, view.lights[0], reach, walks)


def _street(scene: AnyScene, size: tuple[int, int]) -> tuple[Camera, Camera]:
    """Along the street that is nearest to the middle of the city."""
    low, high = scene.bounds
    blocks = round(float(high[0] - low[0]) / PITCH)
    x = _LANE + (PITCH / 2 if blocks % 2 else 0.0)
    places = ((x, _EYE, z) for z in (_FIRST, _LAST))
    first, last = (Camera(p, np.add(p, (0.0, 0.5, -20.0)), vfov=60.0, width=size[0], height=size[1]) for p in places)
    return first, last


def _steps(camera: Camera, length: float) -> tuple[Camera, Camera]:
    """Ahead, and to the side with the eyes."""
    ahead = camera.target - camera.position
    step = length / np.linalg.norm(ahead) * ahead
    position = camera.position + step
    target = _around(camera.target + step, position, camera.up)
    return camera, Camera(position, target, camera.up, camera.vfov, camera.width, camera.height)


def _nearer(camera: Camera) -> Camera:
    """The camera, nearer to what it looks at."""
    position = camera.target + _NEARER * (camera.position - camera.target)
    return Camera(position, camera.target, camera.up, camera.vfov, camera.width, camera.height)


def _turned(camera: Camera, centre) -> Camera:
    """The camera after a part of a flight around a place."""
    position = _around(camera.position, centre, camera.up)
    return Camera(position, camera.target, camera.up, camera.vfov, camera.width, camera.height)


def _around(point, centre, up) -> np.ndarray:
    """A point turned around an axis through another one."""
    axis, v = up / np.linalg.norm(up), point - centre
    along = np.dot(v, axis) * axis
    return centre + along + np.cos(_TURN) * (v - along) + np.sin(_TURN) * np.cross(axis, v)
