"""Light samples in kernels: the patch of a light for a receiver, and the points of the patch."""

from typing import NamedTuple

import numpy as np

from ..kernels.jit import inlined, kernel
from ..scene.lights import AMBIENT, DIRECTIONAL, SPHERE


class Patch(NamedTuple):
    """A light as seen from one receiver: the points base + a u + b v + c w. All fields are float64 scalars."""

    bx: float
    by: float
    bz: float
    ux: float
    uy: float
    uz: float
    vx: float
    vy: float
    vz: float
    wx: float
    wy: float
    wz: float


@inlined
def patch_at(light, x, y, z, nx, ny, nz):
    """The `Patch` of a LightPatch for a receiver at the float32 point (x, y, z).

    (nx, ny, nz): float64, the receiver's unit normal towards the visible side; only AMBIENT uses it.
    """
    b, u, v, w = light.base, light.u, light.v, light.w
    if light.kind == DIRECTIONAL:
        return Patch(x + b[0], y + b[1], z + b[2], u[0], u[1], u[2], v[0], v[1], v[2], w[0], w[1], w[2])
    if light.kind == SPHERE:
        return tangent_disk(b[0], b[1], b[2], light.radius, np.float64(x), np.float64(y), np.float64(z))
    if light.kind == AMBIENT:
        return hemisphere(np.float64(x), np.float64(y), np.float64(z), nx, ny, nz, light.radius)
    return Patch(b[0], b[1], b[2], u[0], u[1], u[2], v[0], v[1], v[2], w[0], w[1], w[2])


@inlined
def moved(patch, x, y, z):
    """The patch with its base moved by (x, y, z)."""
    bx, by, bz, ux, uy, uz, vx, vy, vz, wx, wy, wz = patch
    return Patch(bx + x, by + y, bz + z, ux, uy, uz, vx, vy, vz, wx, wy, wz)


@inlined
def hemisphere(x, y, z, nx, ny, nz, r):
    """A patch around (x, y, z) with u, v at right angles to the unit vector n, and w along it, all of length r."""
    (ux, uy, uz), (vx, vy, vz) = tangents64(nx, ny, nz)
    return Patch(x, y, z, r * ux, r * uy, r * uz, r * vx, r * vy, r * vz, r * nx, r * ny, r * nz)


@inlined
def tangents64(nx, ny, nz):
    """Two unit vectors at right angles to the float64 unit vector n and each other [Duff et al. 2017]."""
    s = np.copysign(1.0, nz)
    a = -1.0 / (s + nz)
    b = nx * ny * a
    return (1.0 + s * nx * nx * a, s * b, -s * nx), (b, s + ny * ny * a, -ny)


@kernel
def tangent_disk(cx, cy, cz, radius, x, y, z):
    """The `Patch` of a sphere: the disk inside the circle where the tangent cone from (x, y, z) touches it; float64."""
    nx, ny, nz = x - cx, y - cy, z - cz
    distance = np.sqrt(nx * nx + ny * ny + nz * nz)
    if distance > 0.0:
        nx, ny, nz = nx / distance, ny / distance, nz / distance
    else:
        nx, ny, nz = 0.0, 0.0, 1.0
    if distance > radius:  # the tangent circle lies in front of the centre and is smaller than the great circle
        shift = radius * radius / distance
        cx, cy, cz = cx + shift * nx, cy + shift * ny, cz + shift * nz
        radius *= np.sqrt(1.0 - (radius / distance) ** 2)
    r, ((ux, uy, uz), (vx, vy, vz)) = radius, tangents64(nx, ny, nz)
    return Patch(cx, cy, cz, r * ux, r * uy, r * uz, r * vx, r * vy, r * vz, -0.0, -0.0, -0.0)


@inlined
def sample_point(patch, a, b, c):
    """The float32 light sample (a, b, c) of a patch: (((base + a u) + b v) + c w) in float64, rounded once."""
    # Eq. (1) of docs/design/lights.md, Eq. (3) of docs/design/sampling.md
    return (
        np.float32(((patch.bx + a * patch.ux) + b * patch.vx) + c * patch.wx),
        np.float32(((patch.by + a * patch.uy) + b * patch.vy) + c * patch.wy),
        np.float32(((patch.bz + a * patch.uz) + b * patch.vz) + c * patch.wz),
    )
