"""A level ground: the points where rays that meet no surface meet a plane below them."""

from typing import NamedTuple

import numpy as np

from ..scene.camera import CameraRays
from ..scene.listed_rays import ListedRays
from .camera_rays import rays_through
from .diffuse import RayPass, camera_pass
from .gbuffer import GBuffer
from .receivers import NOTHING

_FAR = 40.0  # radii of the scene that the ground reaches
_FADES = 0.5  # share of this distance from which shadows fade, so that the ground has no border


class Plane(NamedTuple):
    """A level plane in the recentred frame of a scene, seen from above and up to a distance."""

    axis: int  # that points up: 1 or 2
    height: float
    centre: np.ndarray  # (3,) float64, of the scene
    radius: float

    def fading(self, position: np.ndarray) -> np.ndarray:
        """(...) float32: 1 near the scene, 0 at the end of the ground; position : (..., 3) float32."""
        away = self.distance(position) / self.radius
        x = np.clip((away - _FADES) / (1.0 - _FADES), 0.0, 1.0)
        return (1.0 - x * x * (3.0 - 2.0 * x)).astype(np.float32)

    def distance(self, position: np.ndarray) -> np.ndarray:
        """(...) float64: level distance of points from the middle of the scene."""
        a, b = (position[..., k] - self.centre[k] for k in range(3) if k != self.axis)
        return np.hypot(a, b)


def plane_below(box: np.ndarray, up: str, height: float) -> Plane:
    """The plane of a ground; box : (2, 3), bounds of the scene, and `height`, both in its recentred frame."""
    lower, upper = box.astype(np.float64)
    radius = max(float(np.linalg.norm(upper - lower)) / 2.0, np.finfo(np.float32).tiny)
    return Plane("xyz".index(up), height, (lower + upper) / 2.0, _FAR * radius)


def rays_of(view: CameraRays | ListedRays, wanted: np.ndarray, threads=None) -> RayPass:
    """The rays through the centres of the pixels that are True in `wanted`, (H, W) bool, row by row."""
    if isinstance(view, CameraRays):
        return rays_through(view, wanted, threads)
    return RayPass(*(part[wanted.reshape(-1)] for part in camera_pass(view, slice(0, view.height))))


def ground_gbuffer(plane: Plane, rays: RayPass, wanted: np.ndarray, origin: np.ndarray) -> GBuffer:
    """The ground that rays meet: a G-buffer without faces, whose side is 1 where the ground is seen.

    rays : those of the pixels that are True in `wanted`, (H, W) bool; they meet no surface
    origin : (3,) float64, world position of the frame's origin
    """
    start, along = rays.origins.astype(np.float64), rays.directions.astype(np.float64)
    above, falls = start[:, plane.axis] - plane.height, -along[:, plane.axis]
    t = np.divide(above, falls, out=np.full(len(start), np.inf), where=(above > 0.0) & (falls > 0.0))
    with np.errstate(invalid="ignore", over="ignore"):
        points = start + t[:, None] * along
    points[:, plane.axis] = plane.height
    points = points.astype(np.float32)
    met = plane.distance(points) < plane.radius  # False where nothing is met: NaN or infinity
    position, normal = np.zeros((*wanted.shape, 3), np.float32), np.zeros((*wanted.shape, 3), np.float32)
    depth, side = np.full(wanted.shape, np.inf, np.float32), np.full(wanted.shape, NOTHING, np.int8)
    seen = np.zeros(wanted.shape, bool)
    seen[wanted] = met
    position[seen], normal[seen, plane.axis], depth[seen], side[seen] = points[met], 1.0, t[met], 1
    return GBuffer(position, normal, np.full(wanted.shape, -1, np.int32), depth, side, origin)
