"""The camera's rays as a list, for selected pixels."""

import numpy as np

from ..kernels.jit import kernel
from ..kernels.parallel import items, new_ticket, run, thread_count
from ..scene.camera import CameraRays
from ..scene.listed_rays import ListedRays
from .diffuse import RayPass, camera_pass
from .pixels import pixel_direction


@kernel
def _directions(ticket, pixels, rays, directions):
    for i in items(ticket):
        d = pixel_direction(rays, pixels[i, 1], pixels[i, 0])
        directions[i, 0], directions[i, 1], directions[i, 2] = d


def rays_through(rays: CameraRays | ListedRays, wanted: np.ndarray, threads=None) -> RayPass:
    """The rays through the centres of the pixels that are True in `wanted`, (H, W) bool, row by row."""
    if isinstance(rays, ListedRays):
        return RayPass(*(part[wanted.reshape(-1)] for part in camera_pass(rays, slice(0, rays.height))))
    pixels = np.ascontiguousarray(np.argwhere(wanted))
    m = len(pixels)
    directions = np.empty((m, 3), np.float32)
    run(_directions, thread_count(threads), new_ticket(m, 4096), pixels, rays, directions)
    origins = np.broadcast_to(rays.origin.astype(np.float32), (m, 3)).copy()
    return RayPass(origins, directions, np.full(m, -1, np.int32))
