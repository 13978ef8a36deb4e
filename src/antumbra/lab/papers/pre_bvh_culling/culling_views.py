"""The views of the pre-BVH culling paper, random views beside them, and an animation [Selgrad et al. 2015, Sec. 4].

The paper states neither cameras nor lights. Its captions have "a large and subtle light from above and a smaller,
stronger light from behind" (Fig. 3), "the same scene as above" (Fig. 4), hence the same lights, and "upper level of the
atrium" (Fig. 5). Several cameras fit these words. Those chosen here look straight across or along the building, and
leave about as many triangles as the captions state, so that times can be compared. What culling leaves in general is
therefore measured with random cameras in the same light.
"""

from collections.abc import Generator
from pathlib import Path
from typing import NamedTuple

import numpy as np

from ....base.errors import InputError
from ....engine.scene import AnyScene, Scene, procedural
from ....engine.scene_loading import load
from ....scene.camera import Camera
from ....scene.lights import Light, QuadLight, Vector
from ....scene.mesh import Piece
from ..benchmark_views import real_path


class CullingView(NamedTuple):
    """A view of the paper."""

    figure: str
    scene: AnyScene
    camera: Camera
    lights: list[Light]
    time: float = 0.0  # seconds into the animation


# --- The views of Figures 3 to 6 --------------------------------------------------------------------------------------


_SPONZA = {
    "Figure 3": ((0.0, 170.0, -150.0), (0.0, 350.0, 400.0)),
    "Figure 4": ((0.0, 170.0, 0.0), (1000.0, 250.0, 0.0)),
    "Figure 5": ((-1020.0, 590.0, -370.0), (700.0, 590.0, -370.0)),
}
"""Figure -> position and target of the camera: across the court, along the court, and along the upper gallery."""

_ABOVE = QuadLight((-900.0, 1400.0, -250.0), (1800.0, 0.0, 0.0), (0.0, 0.0, 450.0), intensity=2e6)
_BEHIND = QuadLight((-60.0, 215.0, -225.0), (120.0, 0.0, 0.0), (0.0, 114.0, -37.0), intensity=3e5)
"""The lights in Sponza: one spans the open roof, the other is behind the camera of Figure 3."""


def sponza_scene(sponza: Path | None) -> AnyScene | None:
    """Crytek's Sponza from a file in centimetres, or from $ANTUMBRA_SCENES/sponza_crytek/scene.glb; None without it.

    Raises
    ------
    InputError
        If there is no such file.
    """
    path = real_path("sponza_crytek") if sponza is None else sponza
    if path is not None and not path.exists():
        raise InputError(f"{path}: no such file; give Crytek's Sponza, or omit --sponza")
    return None if path is None else load(path)


def culling_views(sponza: AnyScene | None, size: tuple[int, int], cellar_triangles: int) -> list[CullingView]:
    """The views of Figures 3 to 5, in Crytek's Sponza, and of Figure 6, in a procedural cellar.

    Without Sponza, a view of the procedural atrium with as many triangles replaces the first three.
    """
    cellar = procedural("cellar", triangles=cellar_triangles)
    last = CullingView("Figure 6", cellar, cellar.cameras[0].resized(*size), list(cellar.lights))
    if sponza is None:
        atrium = procedural("atrium", triangles=262_267)
        return [CullingView("atrium", atrium, atrium.cameras[0].resized(*size), list(atrium.lights)), last]
    return [_in_sponza(figure, sponza, *places, size) for figure, places in _SPONZA.items()] + [last]


def _in_sponza(figure: str, scene: AnyScene, position: Vector, target: Vector, size: tuple[int, int]) -> CullingView:
    return CullingView(
        figure, scene, Camera(position, target, vfov=60.0, width=size[0], height=size[1]), [_ABOVE, _BEHIND]
    )


# --- Random views -----------------------------------------------------------------------------------------------------

_PARTS = {
    "court": ((-1000.0, 100.0, -180.0), (1000.0, 350.0, 180.0)),
    "gallery": ((-1200.0, 500.0, -460.0), (1200.0, 700.0, -280.0)),
}
"""Part of Sponza -> the box of the cameras' positions; the gallery has a second box, mirrored in z."""

_PITCH = np.radians(20.0)  # largest angle of a random camera above and below the horizon


def random_views(sponza: AnyScene, cameras: int, size: tuple[int, int]) -> list[CullingView]:
    """Views of cameras in each part of Sponza, with the lights of `culling_views`.

    Positions and directions are uniformly distributed, with the same seed in every run.
    """
    views = []
    for part, (lower, upper) in _PARTS.items():
        rng = np.random.default_rng(2015)
        for k in range(cameras):
            position = rng.uniform(lower, upper) * (1.0, 1.0, 1.0 if k % 2 else -1.0)
            yaw, pitch = rng.uniform((-np.pi, -_PITCH), (np.pi, _PITCH))
            ahead = np.array([np.cos(yaw) * np.cos(pitch), np.sin(pitch), np.sin(yaw) * np.cos(pitch)])
            views.append(_in_sponza(part, sponza, position, position + 100.0 * ahead, size))
    return views


# --- Animation --------------------------------------------------------------------------------------------------------


FIGURE = "video"
SECONDS = 4.0  # length of the animation
_SWAY = 0.02  # largest displacement, as a share of the height above the ground
_FLIGHT = 0.6  # length of the flight, as a share of the distance from the first camera to its target


class Swaying:
    """The geometry of a static scene, displaced sideways in proportion to height (see `scene.mesh.Source`)."""

    duration = SECONDS

    def __init__(self, still: Scene):
        self.file, self.meshes = f"swaying {still.name}", still.meshes
        self.objects = still.objects
        self._pieces, self._cameras, self._lights = list(still.source.pieces(0.0)), still.cameras, still.lights

    def pieces(self, time: float) -> Generator[Piece, None, None]:
        share = np.sin(2.0 * np.pi * time / SECONDS)
        for piece in self._pieces:
            x, y, z = np.moveaxis(np.asarray(piece.vertices, np.float64), -1, 0)
            by = _SWAY * share * y
            moved = np.stack([x + by * np.sin(0.05 * z), y, z + by * np.cos(0.05 * x)], -1)
            yield piece._replace(vertices=moved.astype(piece.vertices.dtype))

    def cameras(self, time: float) -> list[Camera]:
        return self._cameras

    def lights(self, time: float) -> list[Light]:
        return self._lights


def video_views(triangles: int, frames: int, size: tuple[int, int]) -> list[CullingView]:
    """The frames of the animation, as views of one scene with about `triangles` triangles."""
    still = procedural("city", triangles=triangles)
    scene = Scene(Swaying(still), name="swaying city")
    return [_frame(scene, still, time, size) for time in np.linspace(0.0, SECONDS, frames, endpoint=False).tolist()]


def _frame(scene: Scene, still: Scene, time: float, size: tuple[int, int]) -> CullingView:
    start = still.cameras[0]
    position, target = np.asarray(start.position, float), np.asarray(start.target, float)
    at = position + _FLIGHT * time / SECONDS * (target - position)
    camera = Camera(at, target, start.up, start.vfov, *size)
    return CullingView(FIGURE, scene, camera, list(still.lights), time)
