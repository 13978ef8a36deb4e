"""Which triangles rays cross, for products of transmittances: a surface counts once at common edges and vertices."""

import numpy as np

from antumbra.kernels.exact.predicate import ray_along
from antumbra.kernels.exact.surface_crossing import crosses_surface
from antumbra.kernels.jit import kernel
from antumbra.kernels.simd import ptr


@kernel
def _crossings(origins, directions, corners, out):
    values = ptr(corners)
    for r in range(len(origins)):
        o, d = origins[r], directions[r]
        ray = ray_along(o[0], o[1], o[2], d[0], d[1], d[2], 0.0, np.inf)
        for i in range(len(corners)):
            out[r, i] = crosses_surface(ray, values, i)


def crossings(triangles, origins, directions):
    """(rays, triangles) bool: `crosses_surface`, for triangles that the rays meet."""
    out = np.zeros((len(origins), len(triangles)), bool)
    corners = np.ascontiguousarray(triangles, np.float32).reshape(-1, 9)
    _crossings(np.asarray(origins, np.float32), np.asarray(directions, np.float32), corners, out)
    return out
