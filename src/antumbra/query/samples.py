"""Light samples in kernels: where the patch of a light is for a receiver, and its points."""

from typing import NamedTuple

import numpy as np

from ..jit import inlined, kernel
from ..scene.lights import DIRECTIONAL, SPHERE


class Patch(NamedTuple):
    """A light as one receiver sees it: the points base + a u + b v. Float64 scalars."""

    bx: float
    by: float
    bz: float
    ux: float
    uy: float
    uz: float
    vx: float
    vy: float
    vz: float


@inlined
def patch_at(light, x, y, z):
    """The `Patch` of a LightPatch for a receiver at the float32 point (x, y, z)."""
    b, u, v = light.base, light.u, light.v
    if light.kind == DIRECTIONAL:
        return Patch(x + b[0], y + b[1], z + b[2], u[0], u[1], u[2], v[0], v[1], v[2])
    if light.kind == SPHERE:
        return _tangent_disk(b[0], b[1], b[2], light.radius, np.float64(x), np.float64(y), np.float64(z))
    return Patch(b[0], b[1], b[2], u[0], u[1], u[2], v[0], v[1], v[2])


@kernel
def _tangent_disk(cx, cy, cz, radius, x, y, z):
    nx, ny, nz = x - cx, y - cy, z - cz
    distance = np.sqrt(nx * nx + ny * ny + nz * nz)
    if distance > 0.0:
        nx, ny, nz = nx / distance, ny / distance, nz / distance
    else:
        nx, ny, nz = 0.0, 0.0, 1.0
    if distance > radius:  # the circle of tangency lies before the centre and is smaller than the great circle
        shift = radius * radius / distance
        cx, cy, cz = cx + shift * nx, cy + shift * ny, cz + shift * nz
        radius *= np.sqrt(1.0 - (radius / distance) ** 2)
    s = np.copysign(1.0, nz)  # tangents [Duff et al. 2017]
    a = -1.0 / (s + nz)
    b = nx * ny * a
    r = radius
    return Patch(
        cx,
        cy,
        cz,
        r * (1.0 + s * nx * nx * a),
        r * (s * b),
        r * (-s * nx),
        r * b,
        r * (s + ny * ny * a),
        r * -ny,
    )


@inlined
def sample_point(patch, a, b):
    """The float32 light sample (a, b) of a patch: ((base + a u) + b v) in float64, rounded once."""
    return (
        np.float32((patch.bx + a * patch.ux) + b * patch.vx),
        np.float32((patch.by + a * patch.uy) + b * patch.vy),
        np.float32((patch.bz + a * patch.uz) + b * patch.vz),
    )
