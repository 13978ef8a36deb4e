"""What rays see by CHC+RT, as surfaces: of the camera's rays, and of passes of diffuse rays."""

import numpy as np

from ..query.diffuse import RayPass
from ..query.picture import Surfaces, surfaces_of
from ..scene.camera import CameraRays
from ..trace.bounce import surfaces_met
from .nearest import Hits
from .trace import Scheduled, nearest_hits


def camera_pass(rays: CameraRays) -> RayPass:
    """The rays of a camera, one a pixel: the same bits as `query.pixels.pixel_ray`."""
    right, down = np.arange(rays.width) + 0.5, np.arange(rays.height) + 0.5
    directions = (rays.corner + right[:, None] * rays.dx)[None] + (down[:, None] * rays.dy)[:, None]
    m = rays.width * rays.height
    origins = np.ascontiguousarray(np.broadcast_to(np.asarray(rays.origin, np.float32), (m, 3)))
    return RayPass(origins, directions.astype(np.float32).reshape(m, 3), np.full(m, -1, np.int32))


def camera_hits(scheduled: Scheduled, rays: CameraRays, threads=None, progress=None) -> Hits:
    """What a camera's rays see first."""
    return nearest_hits(scheduled, camera_pass(rays), (rays.height, rays.width), threads, progress)


def primary_hits(scheduled: Scheduled, rays: CameraRays, threads=None) -> tuple[np.ndarray, np.ndarray]:
    """The same, as `trace.primary.trace_primary` gives it: (face, t)."""
    hits = camera_hits(scheduled, rays, threads)
    return hits.face, hits.t


def nearest_scheduled(rays: RayPass, shape, scheduled: Scheduled, triangles, threads=None) -> Surfaces:
    """The surfaces that the rays of a picture of this shape meet first; `triangles`: all of the scene."""
    hits = nearest_hits(scheduled, rays, shape, threads)
    met = surfaces_met(rays, hits.face.reshape(-1), hits.t.reshape(-1), shape, triangles, threads)
    return surfaces_of(met, triangles)
