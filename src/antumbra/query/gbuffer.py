"""The G-buffer: the visible surface of each pixel, bit-identical from rasterisation and primary rays.

Also the rays of pixels.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..kernels.exact.predicate import ray_along
from ..kernels.jit import F32Ptr, I8Ptr, inlined, kernel
from ..kernels.parallel import new_ticket, run, shares, thread_count
from ..kernels.simd import get, ptr, put
from ..scene.camera import CameraRays
from ..scene.triangles import Triangles
from .receivers import NOTHING

# --- The ray of a pixel -----------------------------------------------------------------------------------------------


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


# --- The G-buffer -----------------------------------------------------------------------------------------------------


class GBuffer(NamedTuple):
    """The visible surface of each pixel of an (H, W) picture. Background: face -1, depth inf, all else 0."""

    position: np.ndarray  # (H, W, 3) float32, recentred frame (world position = position + origin)
    normal: np.ndarray  # (H, W, 3) float32, geometric, unit length, towards the camera
    face: np.ndarray  # (H, W) int32, index of the face in the scene
    depth: np.ndarray  # (H, W) float32, world units along the view axis
    side: np.ndarray  # (H, W) int8: 1: the triangle's own normal faces the camera; -1: it faces away; 0: background
    origin: np.ndarray  # (3,) float64, world position of the frame's origin

    def __repr__(self) -> str:
        height, width = self.face.shape
        return f"GBuffer({width}x{height}, {(self.face >= 0).mean():.0%} see a surface; {', '.join(self._fields)})"


class SurfacePointers(NamedTuple):
    """Pointers to the arrays that `fill_pixel` writes."""

    position: F32Ptr  # float32 *, 3 per pixel
    normal: F32Ptr  # float32 *, 3 per pixel
    side: I8Ptr  # int8 *


@inlined
def surface_of(gbuffer):
    """The pointers of a `GBuffer`, which must outlive them."""
    return SurfacePointers(ptr(gbuffer.position), ptr(gbuffer.normal), ptr(gbuffer.side))


@inlined
def put3(pointer, at, v):
    """Write row `at` of rows of three float32."""
    f = np.float32
    put(pointer, 3 * at, f(v[0]))
    put(pointer, 3 * at + 1, f(v[1]))
    put(pointer, 3 * at + 2, f(v[2]))


class FaceNormal(NamedTuple):
    """A triangle's normal; float64."""

    x: float
    y: float
    z: float
    scale: float  # 1 / its length


@inlined
def face_normal(corners, i):
    """The `FaceNormal` of triangle i; `corners` is a pointer."""
    f, k = np.float64, 9 * i
    x0, y0, z0 = f(get(corners, k)), f(get(corners, k + 1)), f(get(corners, k + 2))
    px, py, pz = f(get(corners, k + 3)) - x0, f(get(corners, k + 4)) - y0, f(get(corners, k + 5)) - z0
    qx, qy, qz = f(get(corners, k + 6)) - x0, f(get(corners, k + 7)) - y0, f(get(corners, k + 8)) - z0
    x, y, z = py * qz - pz * qy, pz * qx - px * qz, px * qy - py * qx
    return FaceNormal(x, y, z, 1.0 / np.sqrt(x * x + y * y + z * z))


@inlined
def fill_pixel(y, x, normal, t, rays, out, at):
    """Write entry `at`: the point at parameter t of pixel (y, x)'s ray, on a triangle with this `FaceNormal`."""
    f = np.float64
    d, o = pixel_direction(rays, x, y), rays.origin
    fill_point((f(o[0]), f(o[1]), f(o[2])), (f(d[0]), f(d[1]), f(d[2])), normal, t, out, at)


@inlined
def point_at(o, d, normal, t):
    """(position, unit normal towards o, side) at parameter t of the float64 ray from o along d; normal: FaceNormal."""
    dx, dy, dz = d
    away = normal.x * dx + normal.y * dy + normal.z * dz > 0.0
    scale = -normal.scale if away else normal.scale
    position = o[0] + t * dx, o[1] + t * dy, o[2] + t * dz
    return position, (normal.x * scale, normal.y * scale, normal.z * scale), -1 if away else 1


@inlined
def fill_point(o, d, normal, t, out, at):
    """Write entry `at`: the point at parameter t of the float64 ray from o along d, where it meets a triangle."""
    position, towards, side = point_at(o, d, normal, t)
    put3(out.position, at, position)
    put3(out.normal, at, towards)
    put(out.side, at, side)


@kernel
def _fill(ticket, t, corners, rays, row, gbuffer):
    zero, out = np.float32(0.0), surface_of(gbuffer)
    faces, ts, depths, triangles = ptr(gbuffer.face), ptr(t), ptr(gbuffer.depth), ptr(corners)
    for y0, end in shares(ticket):
        last, normal = -1, FaceNormal(0.0, 0.0, 0.0, 0.0)
        for y in range(y0, end):
            for x in range(rays.width):
                at = y * rays.width + x
                i, far = get(faces, at), get(ts, at)
                put(depths, at, far)
                if i >= 0:
                    if i != last:  # neighbouring pixels often see the same triangle
                        last, normal = i, face_normal(triangles, i)
                    fill_pixel(row + y, x, normal, far, rays, out, at)
                else:
                    put(out.side, at, NOTHING)
                    put3(out.position, at, (zero, zero, zero))
                    put3(out.normal, at, (zero, zero, zero))


def from_hits(
    face: NDArray[np.int32],
    t: NDArray[np.float64],
    triangles: Triangles,
    rays: CameraRays,
    threads: int | None = None,
    row: int = 0,
) -> GBuffer:
    """The G-buffer of primary hits.

    face : (H, W) int32, triangle indices or -1
    t : (H, W) float64
    row : row of the picture at which these rows start
    """
    shape = face.shape
    position, normal = np.empty((*shape, 3), np.float32), np.empty((*shape, 3), np.float32)
    depth, side = np.empty(shape, np.float32), np.empty(shape, np.int8)
    gbuffer = GBuffer(position, normal, face, depth, side, triangles.origin)
    ticket = new_ticket(shape[0], 8)
    run(_fill, thread_count(threads), ticket, t, triangles.vertices.reshape(-1, 9), rays, row, gbuffer)
    return gbuffer
