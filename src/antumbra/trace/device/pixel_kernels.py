"""The kernels of the G-buffer on a device: the rays of a camera's pixels, and the surfaces and receivers of their hits.

They call the functions of the CPU's G-buffer (`query.gbuffer`, `query.receivers`). The nearest hits between them are
those of `trace_nearest`. A receiver whose side of its triangle's plane float64 leaves undecided is listed for the CPU.
"""

from typing import NamedTuple

import numpy as np

from ...kernels.device import thread_index
from ...kernels.jit import inlined, kernel
from ...kernels.simd import f32_at, f64_at, get, i32_at, put
from ...kernels.toolchain.device_code import DeviceKernel
from ...query.gbuffer import face_normal, pixel_direction, point_at, put3
from ...query.receivers import NOTHING, plane_of_face, quick_offset
from ...query.shadow_query import three_at
from .device_kernels import HITS, WORK, add_kernels
from .device_rays import SIDE
from .device_traversal import list_pair


class PixelRays(NamedTuple):
    """The rays of some pixels of a perspective camera: `CameraRays` in plain numbers, and which pixels."""

    origin: tuple[float, float, float]
    corner: tuple[float, float, float]
    dx: tuple[float, float, float]
    dy: tuple[float, float, float]
    width: int  # of the picture
    first: int  # the first pixel, row by row
    n: int  # number of pixels


class SurfaceBuffers(NamedTuple):
    """The surfaces of some pixels: addresses on the device."""

    position: int  # float32, 3 per pixel, as `GBuffer.position`
    normal: int  # float32, 3 per pixel
    depth: int  # float32
    receivers: int  # 16 bytes each, as `SampleBuffers.receivers`


@inlined
def _direction(pixels, i):
    at = pixels.first + i
    return pixel_direction(pixels, at % pixels.width, at // pixels.width)


@kernel
def write_pixel_rays(pixels, origins, directions):  # pixels: PixelRays; origins, directions: addresses of float32
    """Write the rays of pixels, for `trace_nearest`."""
    i = thread_index()
    if i < pixels.n:
        put3(f32_at(origins), i, pixels.origin)
        put3(f32_at(directions), i, _direction(pixels, i))


@kernel
def write_surfaces(pixels, hits, vertices, out):  # pixels: PixelRays, hits: HitBuffers, out: SurfaceBuffers
    """Write the surfaces that pixels see, as `gbuffer.from_hits`, and the tags of their receivers."""
    # In: vertices, address of (n, 9) float32
    i, zero, f = thread_index(), np.float64(0.0), np.float64
    if i >= pixels.n:
        return
    face, t = np.int64(get(i32_at(hits.face), i)), get(f64_at(hits.t), i)
    position, normal, side = (zero, zero, zero), (zero, zero, zero), NOTHING
    if face >= 0:
        d = _direction(pixels, i)
        of_face = face_normal(f32_at(vertices), face)
        position, normal, side = point_at(pixels.origin, (f(d[0]), f(d[1]), f(d[2])), of_face, t)
    put3(f32_at(out.position), i, position)
    put3(f32_at(out.normal), i, normal)
    put(f32_at(out.depth), i, np.float32(t))
    put(i32_at(out.receivers), 4 * i + 3, face << 2 | np.int64(side + 1))


@kernel
def move_receivers(surfaces, vertices, work, first, n):  # surfaces: SurfaceBuffers, vertices: address of float32
    """Write n receivers from the `first` on, moved off their surfaces as by `surface_receivers`; list undecided ones.

    A pair of the list, `work`, is (pixel, tag of its receiver). Its length may exceed the capacity.
    """
    k = thread_index()
    if k >= n:
        return
    i, numbers = first + k, f32_at(surfaces.receivers)
    tag, p = np.int64(get(i32_at(surfaces.receivers), 4 * i + 3)), three_at(f32_at(surfaces.position), i)
    x, y, z = np.float32(p[0]), np.float32(p[1]), np.float32(p[2])
    side = (tag & SIDE) - 1
    if side != NOTHING:
        known = plane_of_face(f32_at(vertices), tag >> 2)
        (x, y, z), decided = quick_offset(p, three_at(f32_at(surfaces.normal), i), side, known)
        if not decided:
            list_pair(work, i, tag)
    put(numbers, 4 * i, x)
    put(numbers, 4 * i + 1, y)
    put(numbers, 4 * i + 2, z)


@kernel
def widen_normals(normals, n, out):  # normals: address of float32, out: of float64
    """Write n normals as float64, which lights of ambient occlusion take."""
    i = thread_index()
    if i < n:
        for k in range(3 * i, 3 * i + 3):
            put(f64_at(out), k, np.float64(get(f32_at(normals), k)))


_ZERO = (0.0, 0.0, 0.0)
_PIXELS, _SURFACES = PixelRays(_ZERO, _ZERO, _ZERO, _ZERO, 0, 0, 0), SurfaceBuffers(0, 0, 0, 0)

PIXEL_KERNELS = {
    "write_pixel_rays": DeviceKernel(write_pixel_rays, (_PIXELS, 0, 0)),
    "write_surfaces": DeviceKernel(write_surfaces, (_PIXELS, HITS, 0, _SURFACES)),
    "move_receivers": DeviceKernel(move_receivers, (_SURFACES, 0, WORK, 0, 0)),
    "widen_normals": DeviceKernel(widen_normals, (0, 0, 0)),
}
"""Name -> kernel."""

add_kernels(PIXEL_KERNELS)
