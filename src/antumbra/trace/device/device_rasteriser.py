"""The rasteriser of a device: what a perspective camera sees of new triangles, of which there is no tree yet.

Pre-BVH culling needs the surfaces that a camera sees before it can drop triangles [Selgrad et al. 2015, Sec. 3]. By
rasterisation they take no tree of all triangles.
"""

import numpy as np
from numpy.typing import NDArray

from ...bvh.nodes import Bvh
from ...devices.device import OutOfDeviceMemory
from ...query.query_bounds import triangle_box
from ...query.raster_bins import make_padding
from ...query.raster_setup import make_view
from ...scene.camera import CameraRays
from ...scene.triangles import Triangles
from ..alpha_cutouts import CutoutTree
from .build_kernels import Source
from .device_kernels import HitBuffers
from .device_launches import DeviceLaunches
from .device_rays import RayBuffers
from .device_stages import Chunk
from .device_surfaces import DeviceSurfaces, write_surfaces
from .device_tracer import DeviceTracer
from .device_traversal import COUNTS, PAIRS, PARTS, TRIANGLE, Work
from .device_tree import DeviceTree
from .pixel_kernels import PixelRays
from .raster_kernels import (
    BOUND,
    CELL,
    CELLS,
    CLAIM,
    ENTRY,
    PART,
    UNBOUNDED,
    DrawnTriangles,
    RasterCamera,
    RasterTargets,
)
from .tree_build import keep_tagged

_PARTS = 1 << 14  # at first
_MOST = 1 << 28  # entries of a list


class SeenTriangles(DeviceTree):
    """The triangles whose bounds hold pixel centres, by slot, without nodes, until the next ones on this device.

    source : Source
        All solid triangles.
    camera : RasterCamera
    box : (2, 3) float32, the bounds of all triangles
    launches : DeviceLaunches
    """

    def __init__(
        self, source: Source, camera: RasterCamera, box: NDArray[np.float32], launches: DeviceLaunches
    ) -> None:
        tags = launches.block("tags", 4 * (source.n + 1), "the tags of triangles")
        launches.launch("tag_seen", (source, camera, tags.address), source.n + 1)
        seen = keep_tagged(source, tags, launches)
        triangles = launches.block("seen", max(4 * TRIANGLE * seen.n, 64), "the triangles that the camera may see")
        super().__init__(launches, triangles, triangles, seen.n)  # there are no nodes, and nobody reads any
        x, y, z = np.abs(box).max(0)
        self.reach = x, y, z
        launches.launch("write_triangles", (self.buffers, seen.faces, 1, seen.vertices, seen.n), seen.n)

    @property
    def bvh(self) -> Bvh:
        """The triangles on the host, for decisions there."""
        return self.some(np.arange(self.n, dtype=np.int32))


class DeviceRasteriser:
    """Finds the nearest hits of the rays of pixels, those of `DeviceTracer.nearest_hits`, without a tree.

    Parameters
    ----------
    tracer : DeviceTracer
        Its lock is held.
    triangles : Triangles
        All triangles of the scene; they are copied to the device unless they are there.
    camera : RasterCamera
        With all pixels of the picture.
    cutouts : CutoutTree or None
        The triangles that are not solid; None: there are none.
    threads : int
        Of the CPU, which decides what the device cannot.

    Raises
    ------
    OutOfDeviceMemory
        If they do not fit.
    """

    def __init__(
        self,
        tracer: DeviceTracer,
        triangles: Triangles,
        camera: RasterCamera,
        cutouts: CutoutTree | None,
        threads: int,
    ) -> None:
        self._tracer, self._cutouts, self._threads = tracer, cutouts, threads
        launches, self._camera = tracer.launches, camera
        vertices, n = launches.address_of(triangles), len(triangles.face_id)
        faces = triangles.solid
        ids = 0 if faces is None else launches.sent("source", faces, "the solid triangles")
        box = triangle_box(triangles, threads) if n else np.zeros((2, 3), np.float32)
        source = Source(vertices, ids, n if faces is None else len(faces))
        self._seen = SeenTriangles(source, self._camera, box, launches)

    def nearest_hits(self, pixels: PixelRays, rays: RayBuffers) -> tuple[Work, HitBuffers]:
        """The nearest hits of the rays of some pixels, on the device until the next call.

        rays : those of the pixels, on the device

        Raises
        ------
        OutOfDeviceMemory
            If the lists of a hostile scene do not fit.
        """
        chunk = self._tracer.chunk_in(rays, pixels.n, 0, False)
        chunk, pairs = self._draw(pixels, chunk)
        self._tracer.undecided += pairs
        self._tracer.settle(self._seen, chunk, pairs, self._threads)
        return self._tracer.hits_of(self._seen, chunk, self._cutouts, self._threads)

    def _draw(self, pixels: PixelRays, chunk: Chunk) -> tuple[Chunk, int]:
        """Draw all triangles into some pixels: the chunk, whose list has room for all undecided tests, and how many."""
        launches, n, work = self._tracer.launches, pixels.n, chunk.work
        drawn = DrawnTriangles(self._seen.buffers, self._seen.n)
        camera = self._camera._replace(first=pixels.first, n=n)
        bounds, claims = (launches.block(f"{name} of pixels", 4 * n, "the pixels") for name in ("bounds", "claims"))
        bounds.fill(UNBOUNDED)
        out, counts = launches.block("out", 0, ""), launches.block("counts", 0, "")
        targets, parts = RasterTargets(bounds.address, claims.address, 0, _PARTS, PART // CELL, BOUND), 0
        while True:
            block = launches.block("parts of triangles", 4 * ENTRY * targets.capacity, "the parts of triangles")
            targets = targets._replace(parts=block.address)
            counts.fill()
            launches.launch("draw_triangles", (drawn, camera, chunk.rays, work, targets), drawn.n)
            parts = _count(launches, PARTS)
            if parts <= targets.capacity:
                break
            targets = targets._replace(capacity=_longer(parts, targets.capacity))
        launches.launch("draw_parts", (drawn, camera, chunk.rays, work, targets, parts), CELLS * parts)
        targets = targets._replace(step=CLAIM)
        while True:
            claims.fill()
            out.fill(0xFF, size=4 * n)  # NO_HIT
            counts.fill()
            launches.launch("draw_triangles", (drawn, camera, chunk.rays, work, targets), drawn.n)
            launches.launch("draw_parts", (drawn, camera, chunk.rays, work, targets, parts), CELLS * parts)
            pairs = _count(launches, PAIRS)
            if pairs <= work.capacity:
                return chunk._replace(work=work), pairs
            capacity = _longer(pairs, work.capacity)
            block = launches.block("pairs", 8 * capacity, "the list of undecided tests")
            work = work._replace(pairs=block.address, capacity=capacity)


def _count(launches: DeviceLaunches, which: int) -> int:
    return int(launches.block("counts", 0, "").read(np.empty(COUNTS, np.int32))[which])


def _longer(needed: int, capacity: int) -> int:
    """A longer list: a count beyond the capacity is only a lower bound of what is needed."""
    longer = max(needed, 4 * capacity)
    if longer > _MOST:
        raise OutOfDeviceMemory(f"the lists of a rasteriser are limited to {_MOST} entries", longer, _MOST)
    return longer


def draw_surfaces(
    tracer: DeviceTracer, triangles: Triangles, rays: CameraRays, cutouts: CutoutTree | None, threads: int
) -> DeviceSurfaces | None:
    """The surfaces that a perspective camera sees, as from `see_surfaces`, without a tree. The same errors.

    None if float32 rounds the rays so coarsely that triangles have no bounds: the picture's angle is tiny. The other
    arguments are those of `DeviceRasteriser`.
    """
    view = make_view(rays)
    padding = make_padding(view)
    if not padding.usable:
        return None
    with tracer.lock:
        camera = RasterCamera(view, padding, 0, rays.width * rays.height)
        rasteriser = DeviceRasteriser(tracer, triangles, camera, cutouts, threads)
        return write_surfaces(tracer, triangles, rays, rasteriser.nearest_hits, threads)
