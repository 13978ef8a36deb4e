"""The G-buffer: what each pixel sees, made by rasterisation or by primary rays; both give the same bits."""

from typing import NamedTuple

import numpy as np

from ..jit import kernel
from ..parallel import CHUNK, N, new_ticket, run, take, thread_count
from ..scene.camera import CameraRays
from .pixels import pixel_direction
from .receivers import NOTHING


class GBuffer(NamedTuple):
    """What each pixel of an (H, W) picture sees. Where it sees nothing: face -1, depth inf, the rest 0."""

    position: np.ndarray  # (H, W, 3) float32, recentred frame (world position = position + origin)
    normal: np.ndarray  # (H, W, 3) float32, geometric, unit length, towards the camera
    face: np.ndarray  # (H, W) int32, index of the face in the scene
    depth: np.ndarray  # (H, W) float32, world units along the view axis
    side: np.ndarray  # (H, W) int8: 1 where the triangle's own normal points to the camera, -1 where away, 0: nothing
    origin: np.ndarray  # (3,) float64, world position of the frame's zero


@kernel
def fill_pixel(y, x, i, t, corners, rays, position, normal, side, v, u):
    """Write at (v, u) where the ray of pixel (y, x) meets triangle i, at t."""
    f = np.float64
    dx, dy, dz = pixel_direction(rays, x, y)
    position[v, u, 0] = np.float32(f(rays.origin[0]) + t * f(dx))
    position[v, u, 1] = np.float32(f(rays.origin[1]) + t * f(dy))
    position[v, u, 2] = np.float32(f(rays.origin[2]) + t * f(dz))
    x0, y0, z0 = f(corners[i, 0]), f(corners[i, 1]), f(corners[i, 2])
    px, py, pz = f(corners[i, 3]) - x0, f(corners[i, 4]) - y0, f(corners[i, 5]) - z0
    qx, qy, qz = f(corners[i, 6]) - x0, f(corners[i, 7]) - y0, f(corners[i, 8]) - z0
    nx, ny, nz = py * qz - pz * qy, pz * qx - px * qz, px * qy - py * qx
    away = nx * f(dx) + ny * f(dy) + nz * f(dz) > 0.0
    length = np.sqrt(nx * nx + ny * ny + nz * nz)
    scale = (-1.0 if away else 1.0) / length
    normal[v, u, 0], normal[v, u, 1], normal[v, u, 2] = (
        np.float32(nx * scale),
        np.float32(ny * scale),
        np.float32(nz * scale),
    )
    side[v, u] = -1 if away else 1


@kernel
def _fill(ticket, face, t, corners, rays, position, normal, depth, side):
    y0 = take(ticket)
    while y0 >= 0:
        for y in range(y0, min(y0 + ticket[CHUNK], ticket[N])):
            for x in range(rays.width):
                depth[y, x] = np.float32(t[y, x])
                i = face[y, x]
                if i >= 0:
                    fill_pixel(y, x, i, t[y, x], corners, rays, position, normal, side, y, x)
                else:
                    side[y, x] = NOTHING
                    for k in range(3):
                        position[y, x, k], normal[y, x, k] = np.float32(0.0), np.float32(0.0)
        y0 = take(ticket)


def from_hits(face, t, triangles, rays: CameraRays, threads=None) -> GBuffer:
    """The G-buffer of known primary hits: face (H, W) int32 triangle indices or -1, t (H, W) float64."""
    shape = face.shape
    position, normal = np.empty((*shape, 3), np.float32), np.empty((*shape, 3), np.float32)
    depth, side = np.empty(shape, np.float32), np.empty(shape, np.int8)
    corners = triangles.vertices.reshape(-1, 9)
    ticket = new_ticket(shape[0], 8)
    run(_fill, thread_count(threads), ticket, face, t, corners, rays, position, normal, depth, side)
    return GBuffer(position, normal, face, depth, side, triangles.origin)
