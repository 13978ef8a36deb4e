"""What rays see by CHC+RT, as surfaces: of the camera's rays, and of passes of diffuse rays."""

import numpy as np

from ..jit import kernel
from ..parallel import CHUNK, N, new_ticket, run, take, thread_count
from ..query.diffuse import RayPass
from ..query.picture import Surfaces, surfaces_of
from ..query.pixels import pixel_direction
from ..scene.camera import CameraRays
from ..trace.bounce import surfaces_met
from .nearest import Hits
from .trace import Scheduled, nearest_hits


@kernel
def _pixel_rays(ticket, rays, origins, directions):
    """Worker: the rays of rows of pixels."""
    o = rays.origin
    y0 = take(ticket)
    while y0 >= 0:
        for y in range(y0, min(y0 + ticket[CHUNK], ticket[N])):
            for x in range(rays.width):
                at = y * rays.width + x
                origins[at, 0], origins[at, 1], origins[at, 2] = o[0], o[1], o[2]
                directions[at, 0], directions[at, 1], directions[at, 2] = pixel_direction(rays, x, y)
        y0 = take(ticket)


def camera_pass(rays: CameraRays, threads=None) -> RayPass:
    """The rays of a camera, one a pixel."""
    m = rays.width * rays.height
    made = RayPass(np.empty((m, 3), np.float32), np.empty((m, 3), np.float32), np.full(m, -1, np.int32))
    run(_pixel_rays, thread_count(threads), new_ticket(rays.height, 8), rays, made.origins, made.directions)
    return made


def camera_hits(scheduled: Scheduled, rays: CameraRays, threads=None, progress=None) -> Hits:
    """What a camera's rays see first."""
    return nearest_hits(scheduled, camera_pass(rays, threads), (rays.height, rays.width), threads, progress)


def primary_hits(scheduled: Scheduled, rays: CameraRays, threads=None) -> tuple[np.ndarray, np.ndarray]:
    """The same, as `trace.primary.trace_primary` gives it: (face, t)."""
    hits = camera_hits(scheduled, rays, threads)
    return hits.face, hits.t


def nearest_scheduled(rays: RayPass, shape, scheduled: Scheduled, triangles, threads=None) -> Surfaces:
    """The surfaces that the rays of a picture of this shape meet first; `triangles`: all of the scene."""
    hits = nearest_hits(scheduled, rays, shape, threads)
    met = surfaces_met(rays, hits.face.reshape(-1), hits.t.reshape(-1), shape, triangles, threads)
    return surfaces_of(met, triangles)
