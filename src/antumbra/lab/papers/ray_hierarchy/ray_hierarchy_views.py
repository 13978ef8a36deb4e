"""The pictures of the benchmark of ray hierarchies: a scene at one time, a camera, and one point light.

BART's scenes have BART's own cameras. The robots come from `animated.glb` in their folder, which has their camera and
light. The museum consists of vertex frames, and its camera is in `camera.json` beside them. Without these files, the
scenes have the static camera of their info.json.

Static scenes give one picture each. Animations also give frames, evenly spaced, for Figures 6 and 7.
"""

import json
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ....cli.scene_arguments import quietly
from ....engine.scene import AnyScene
from ....engine.scene_loading import load
from ....scene.camera import Camera
from ....scene.lights import Light, PointLight
from ..bench_runner import Say
from ..benchmark_views import BenchmarkScenes, BenchmarkView, point, real_path, scene_view
from .ray_hierarchy_published import CORRIDOR, ROBOT, ROBOTS_FRAMES, ROBOTS_SECONDS, WALL

ROBOTS, MUSEUM = "bart_robots", "bart_museum8_subdivided"
SCENES = BenchmarkScenes(
    real=(ROBOTS, MUSEUM, "sponza_crytek", "synthetic_garden_foxes"),
    beside_real=(),
    without_real=("atrium", "forest"),
    make_light=point,
    moving=(ROBOTS, MUSEUM),
)

WALL_PICTURE = f"robots, wall (frame {WALL})"
MOMENTS = {
    f"robots, corridor (frame {CORRIDOR})": CORRIDOR,
    f"robots, robot at a wall (frame {ROBOT})": ROBOT,
    WALL_PICTURE: WALL,
}
"""Name -> frame number of the robots' pictures."""

MUSEUM_SECONDS = (1.25, 3.5, 4.5, 2.0)
"""Four moments of the museum in the order of Table 2, whose frames the report does not name.

Of BART's path, 4.5 s has the most screen coherence with the sculpture in view, and 2.0 s the least: sorting saves 2 and
12 times as many nodes at 96 x 96 pixels.
"""


class PictureCase(NamedTuple):
    """A scene at one time."""

    name: str
    of: str  # name of the scene
    frame: int | None  # frame number in an animation; None: one of the large pictures
    scene: AnyScene
    camera: Camera
    light: Light
    time: float  # seconds


# --- Cameras over time ------------------------------------------------------------------------------------------------


class CameraPath(NamedTuple):
    """A perspective camera over time, interpolated linearly between keys."""

    times: NDArray[np.float64]  # (k,) seconds, increasing
    positions: NDArray[np.float64]  # (k, 3)
    targets: NDArray[np.float64]  # (k, 3)
    ups: NDArray[np.float64]  # (k, 3)
    vfov: float  # degrees

    def at(self, time: float, size: tuple[int, int]) -> Camera:
        """The camera at a time in seconds, clamped to the keys."""
        position, target, up = (
            tuple(np.interp(time, self.times, values[:, axis]) for axis in range(3))
            for values in (self.positions, self.targets, self.ups)
        )
        return Camera(position, target, up, self.vfov, *size)


def read_camera_path(path: Path) -> CameraPath:
    """The `CameraPath` in a camera.json: times, position, target, up and vfov."""
    keys = json.loads(path.read_text())
    times, positions, targets, ups = (np.array(keys[name], float) for name in ("times", "position", "target", "up"))
    return CameraPath(times, positions, targets, ups, float(keys["vfov"]))


def camera_of(view: BenchmarkView) -> Callable[[float], Camera]:
    """The camera of a view as a function of the time in seconds: BART's own for its scenes, else a static one."""
    size = view.camera.width, view.camera.height
    keys = real_path(MUSEUM, "camera.json") if view.name == MUSEUM else None
    if keys is not None:
        path = read_camera_path(keys)
        return lambda time: path.at(time, size)
    if has_own_film(view):
        return lambda time: view.scene.camera(0, time).resized(*size)
    return lambda time: view.camera


def has_own_film(view: BenchmarkView) -> bool:
    """Whether the view is BART's animation of the robots, with its camera."""
    return view.name == ROBOTS and bool(view.scene.cameras)


# --- Views and their pictures -----------------------------------------------------------------------------------------


def open_view(name: str, size: tuple[int, int]) -> BenchmarkView:
    """The view of a scene, with one point light; the robots come from `animated.glb` if it exists.

    Raises
    ------
    InputError
        If there is no such scene.
    """
    animated = real_path(name, "animated.glb") if name == ROBOTS else None
    if animated is None:
        return with_point(SCENES.view(name, size))
    with quietly():
        return with_point(scene_view(name, load(animated), size))


def open_views(names: Iterable[str] | None, size: tuple[int, int], say: Say) -> list[BenchmarkView]:
    """The views of distinct names, or of the default scenes."""
    say("opening the scenes")
    return [open_view(name, size) for name in dict.fromkeys(names or SCENES.default_names())]


def with_point(view: BenchmarkView) -> BenchmarkView:
    """The view with a single point light, at the centre of its first light."""
    light, bounds = view.lights[0], view.scene.bounds
    patch = light.patch(view.scene.origin, float(np.linalg.norm(bounds[1] - bounds[0])))
    middle = patch.base + (patch.u + patch.v) / 2 if light.domain == "square" else patch.base
    return view._replace(lights=[PointLight(view.scene.origin + middle)])


def times_of(scene: AnyScene, frames: int) -> list[float]:
    """`frames` times, evenly spaced over the animation; 0 alone for a static scene."""
    return np.linspace(0.0, scene.duration, frames).tolist() if scene.animated else [0.0]


def pictures(view: BenchmarkView) -> list[PictureCase]:
    """The large pictures of a view.

    They are the frames `MOMENTS` of the robots, the museum at `MUSEUM_SECONDS`, the middle of another animation, or one
    picture of a static scene.
    """
    if view.name == MUSEUM:
        moments = {f"museum, {time:.2f} s": time for time in MUSEUM_SECONDS}
    elif has_own_film(view):
        moments = {name: _robots_time(number) for name, number in MOMENTS.items()}
    elif view.scene.animated:
        moments = {f"{view.name}, {view.scene.duration / 2:.2f} s": view.scene.duration / 2}
    else:
        moments = {view.name: 0.0}
    return [_picture(view, name, None, time) for name, time in moments.items()]


def film(view: BenchmarkView, frames: int, size: tuple[int, int]) -> list[PictureCase]:
    """Evenly spaced frames of an animation for Figures 6 and 7; none of the museum, which Table 2 shows.

    frames : number of frames; frames of the robots are among BART's 800
    size : pixels
    """
    if view.name == MUSEUM or not view.scene.animated:
        return []
    small = view._replace(camera=view.camera.resized(*size))
    if has_own_film(view):
        moments = {k: _robots_time(k) for k in (k * ROBOTS_FRAMES // frames for k in range(frames))}
    else:
        moments = dict(enumerate(times_of(view.scene, frames)))
    return [_picture(small, f"{view.name}, frame {k}", k, time) for k, time in moments.items()]


def _picture(view: BenchmarkView, name: str, frame: int | None, time: float) -> PictureCase:
    return PictureCase(name, view.name, frame, view.scene, camera_of(view)(time), view.lights[0], time)


def _robots_time(frame: int) -> float:
    return frame * ROBOTS_SECONDS / (ROBOTS_FRAMES - 1)
