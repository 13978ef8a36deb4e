"""The ray of a pixel, with the same bits in rasterisation and ray tracing."""

import numpy as np

from ..kernels.jit import inlined
from ..kernels.predicate.exact import ray_along


@inlined
def pixel_direction(rays, x, y):
    """Direction through the centre of pixel (x, y): three float32, rounded once from float64 (see `CameraRays`)."""
    right, down = np.float64(x) + 0.5, np.float64(y) + 0.5
    corner, dx, dy = rays.corner, rays.dx, rays.dy
    return (
        np.float32((corner[0] + right * dx[0]) + down * dy[0]),
        np.float32((corner[1] + right * dx[1]) + down * dy[1]),
        np.float32((corner[2] + right * dx[2]) + down * dy[2]),
    )


@inlined
def pixel_ray(rays, x, y):
    """The ray of pixel (x, y), over (0, inf)."""
    o, d = rays.origin, pixel_direction(rays, x, y)
    return ray_along(o[0], o[1], o[2], d[0], d[1], d[2], 0.0, np.inf)
