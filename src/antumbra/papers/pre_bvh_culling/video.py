"""An animated procedural scene for Table 4, in place of the paper's video: a city that sways, and a camera that flies.

Every triangle above the ground moves in every frame, so nothing of an earlier frame can be used as it is.
"""

from collections.abc import Iterator

import numpy as np

from ...engine.scene import Scene, procedural
from ...scene.camera import Camera
from ...scene.mesh import Piece
from .views import CullingView

FIGURE = "video"
SECONDS = 4.0  # length of the animation
_SWAY = 0.02  # of the height above the ground, at most
_FLIGHT = 0.6  # of the way from the first camera to its target, at the end


class Swaying:
    """The geometry of a still scene, moved sideways in proportion to its height (see `scene.mesh.Source`)."""

    duration = SECONDS

    def __init__(self, still: Scene):
        self.file, self.meshes = f"swaying {still.name}", still.meshes
        self.objects = still.objects
        self._pieces, self._cameras, self._lights = list(still.source.pieces(0.0)), still.cameras, still.lights

    def pieces(self, time: float) -> Iterator[Piece]:
        share = np.sin(2.0 * np.pi * time / SECONDS)
        for piece in self._pieces:
            x, y, z = np.moveaxis(np.asarray(piece.vertices, np.float64), -1, 0)
            by = _SWAY * share * y
            moved = np.stack([x + by * np.sin(0.05 * z), y, z + by * np.cos(0.05 * x)], -1)
            yield piece._replace(vertices=moved.astype(piece.vertices.dtype))

    def cameras(self, time: float) -> list:
        return self._cameras

    def lights(self, time: float) -> list:
        return self._lights


def video_views(triangles: int, frames: int, size: tuple[int, int]) -> list[CullingView]:
    """The frames of the animation, as views of one scene of about so many triangles."""
    still = procedural("city", triangles=triangles)
    scene = Scene(Swaying(still), name="swaying city")
    return [_frame(scene, still, time, size) for time in np.linspace(0.0, SECONDS, frames, endpoint=False).tolist()]


def _frame(scene: Scene, still: Scene, time: float, size: tuple[int, int]) -> CullingView:
    start = still.cameras[0]
    position, target = np.asarray(start.position, float), np.asarray(start.target, float)
    at = position + _FLIGHT * time / SECONDS * (target - position)
    camera = Camera(at, target, start.up, start.vfov, *size)
    return CullingView(FIGURE, scene, camera, list(still.lights), time)
