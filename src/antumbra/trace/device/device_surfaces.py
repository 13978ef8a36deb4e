"""The surfaces that a camera sees, found on a device by primary rays, where they and their receivers stay.

They are those of the CPU's G-buffer, bit for bit. What the host reads is copied there, once.
"""

from collections.abc import Callable, Iterator
from functools import cached_property
from math import prod

import numpy as np
from numpy.typing import NDArray

from ...devices.device import Device
from ...query.receivers import surface_receivers
from ...scene.camera import CameraRays
from ...scene.triangles import Triangles
from ..alpha_cutouts import CutoutTree
from .device_kernels import HitBuffers
from .device_launches import DeviceLaunches
from .device_rays import SIDE, RayBuffers
from .device_tracer import DeviceTracer
from .device_traversal import COUNTS, PAIRS, Work
from .device_tree import DeviceTree
from .pixel_kernels import PixelRays, SurfaceBuffers

AT_ONCE = 1 << 20
"""Largest number of pixels traced together, with 48 bytes of rays and hits each."""

_BYTES = SurfaceBuffers(12, 12, 4, 16)  # per pixel


class DeviceSurfaces:
    """The surfaces of a picture on a device, a `query.resident_gbuffer.ResidentSurfaces`.

    tracer : DeviceTracer
    triangles : Triangles
        All triangles of the scene.
    shape : (height, width) of the picture

    Raises
    ------
    OutOfDeviceMemory
        If they do not fit.
    """

    def __init__(self, tracer: DeviceTracer, triangles: Triangles, shape: tuple[int, int]) -> None:
        self._tracer, self.triangles, self.shape = tracer, triangles, shape
        self.n = prod(shape)
        whole = (self.device.allocate(size * self.n, "the surfaces of pixels") for size in _BYTES)
        self._position, self._normal, self._depth, self.receivers = whole

    @property
    def device(self) -> Device:
        return self._tracer.device

    def buffers(self, first: int) -> SurfaceBuffers:
        """The buffers from a pixel on."""
        blocks = self._position, self._normal, self._depth, self.receivers
        return SurfaceBuffers(*(block.address + size * first for block, size in zip(blocks, _BYTES)))

    def wide_normals(self) -> int:
        """The address of the normals in float64, until the next call on this device."""
        with self._tracer.lock:
            launches = self._tracer.launches
            out = launches.block("normals", 24 * self.n, "the receivers' normals").address
            launches.launch("widen_normals", (self._normal.address, self.n, out), self.n)
            return out

    def corners_of(self, faces: NDArray[np.int32]) -> NDArray[np.float32]:
        with self._tracer.lock:
            launches = self._tracer.launches
            return launches.rows_at(launches.address_of(self.triangles), faces, 3)

    # On the host

    @cached_property
    def position(self) -> NDArray[np.float32]:
        with self._tracer.lock:
            return self._position.read(np.empty((*self.shape, 3), np.float32))

    @cached_property
    def normal(self) -> NDArray[np.float32]:
        with self._tracer.lock:
            return self._normal.read(np.empty((*self.shape, 3), np.float32))

    @cached_property
    def normals(self) -> NDArray[np.float64]:
        return self.normal.astype(np.float64)

    @cached_property
    def depth(self) -> NDArray[np.float32]:
        with self._tracer.lock:
            return self._depth.read(np.empty(self.shape, np.float32))

    @cached_property
    def _packed(self) -> NDArray[np.float32]:
        with self._tracer.lock:
            return self.receivers.read(np.empty((*self.shape, 4), np.float32))

    @cached_property
    def origins(self) -> NDArray[np.float32]:
        return np.ascontiguousarray(self._packed[..., :3])

    @cached_property
    def face(self) -> NDArray[np.int32]:
        return np.ascontiguousarray(self._packed.view(np.int32)[..., 3]) >> 2

    @cached_property
    def side(self) -> NDArray[np.int8]:
        return ((self._packed.view(np.int32)[..., 3] & SIDE) - 1).astype(np.int8)


def see_surfaces(
    tracer: DeviceTracer,
    tree: DeviceTree,
    triangles: Triangles,
    rays: CameraRays,
    cutouts: CutoutTree | None,
    threads: int,
) -> DeviceSurfaces:
    """The surfaces that a perspective camera sees.

    Parameters
    ----------
    tracer : DeviceTracer
    tree : DeviceTree
        Of all solid triangles.
    triangles : Triangles
        All triangles of the scene; they are copied to the device unless they are there.
    rays : CameraRays
    cutouts : CutoutTree or None
        The other triangles; None: there are none.
    threads : int
        Of the CPU, which decides what the device cannot.

    Raises
    ------
    OutOfDeviceMemory
        If they do not fit.
    """

    def nearest(pixels: PixelRays, seen: RayBuffers) -> tuple[Work, HitBuffers]:
        return tracer.nearest_hits(tree, seen, pixels.n, cutouts, threads)

    with tracer.lock:
        return write_surfaces(tracer, triangles, rays, nearest, threads)


def write_surfaces(
    tracer: DeviceTracer,
    triangles: Triangles,
    rays: CameraRays,
    nearest: Callable[[PixelRays, RayBuffers], tuple[Work, HitBuffers]],
    threads: int,
) -> DeviceSurfaces:
    """The surfaces at the nearest hits of all pixels; the tracer's lock is held. Otherwise as `see_surfaces`.

    nearest : the hits of some pixels, whose rays are on the device, as from `DeviceTracer.nearest_hits`
    """
    surfaces = DeviceSurfaces(tracer, triangles, (rays.height, rays.width))
    launches, vertices = tracer.launches, tracer.launches.address_of(triangles)
    for pixels in parts_of(rays, slice(0, rays.height)):
        work, hits = nearest(pixels, rays_of_pixels(pixels, launches))
        out = surfaces.buffers(pixels.first)
        launches.launch("write_surfaces", (pixels, hits, vertices, out), pixels.n)
        _move_receivers(tracer, out, vertices, work, threads)
    return surfaces


def pixels_of(rays: CameraRays, first: int, n: int) -> PixelRays:
    """n pixels of a picture from the `first` on, row by row."""
    corner, dx, dy = ((float(v[0]), float(v[1]), float(v[2])) for v in (rays.corner, rays.dx, rays.dy))
    origin = float(rays.origin[0]), float(rays.origin[1]), float(rays.origin[2])
    return PixelRays(origin, corner, dx, dy, rays.width, first, n)


def parts_of(rays: CameraRays, rows: slice) -> Iterator[PixelRays]:
    """The pixels of some rows of a picture, at most AT_ONCE at a time."""
    end = rows.stop * rays.width
    for first in range(rows.start * rays.width, end, AT_ONCE):
        yield pixels_of(rays, first, min(AT_ONCE, end - first))


def rays_of_pixels(pixels: PixelRays, launches: DeviceLaunches) -> RayBuffers:
    """The rays of pixels, written on the device, until the next rays there."""
    origins, ends = (launches.block(name, 12 * pixels.n, "the rays").address for name in ("origins", "ends"))
    launches.launch("write_pixel_rays", (pixels, origins, ends), pixels.n)
    return RayBuffers(origins, ends, 0, 0, 0, 0, 0.0, np.inf, -1)


def _move_receivers(tracer: DeviceTracer, out: SurfaceBuffers, vertices: int, work: Work, threads: int) -> None:
    """Write the receivers of surfaces; the CPU moves those that float64 leaves undecided."""
    launches, begin, at_once = tracer.launches, 0, work.n
    counts, pairs = launches.block("counts", 0, ""), launches.block("pairs", 0, "")
    while begin < work.n:
        n = min(at_once, work.n - begin)
        counts.fill()
        launches.launch("move_receivers", (out, vertices, work, begin, n), n)
        left = int(counts.read(np.empty(COUNTS, np.int32))[PAIRS])
        if left > work.capacity:
            at_once = work.capacity
            continue
        if left:
            _move_on_cpu(tracer, out, vertices, pairs.read(np.empty((left, 2), np.int32)), threads)
        begin += n


def _move_on_cpu(
    tracer: DeviceTracer, out: SurfaceBuffers, vertices: int, pairs: NDArray[np.int32], threads: int
) -> None:
    """Move the receivers of a list, pairs of pixels and tags."""
    (pixels, tags), rows_at = np.ascontiguousarray(pairs.T), tracer.launches.rows_at
    moved = surface_receivers(
        rows_at(out.position, pixels),
        rows_at(out.normal, pixels),
        np.arange(len(pixels), dtype=np.int32),
        ((tags & SIDE) - 1).astype(np.int8),
        rows_at(vertices, tags >> 2, 3),
        threads,
    )
    places = 4 * pixels[:, None] + np.arange(3, dtype=np.int32)
    tracer.launches.mark(out.receivers, places.reshape(-1), moved.view(np.int32).reshape(-1))
