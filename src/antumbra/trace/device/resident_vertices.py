"""New vertices of a scene in arrays on the device that traces it: recentred and surveyed there.

The survey is that of `scene.triangle_setup`: the bounds, and the triangles with area. Float64 finds almost all of
these; the CPU decides the others exactly.
"""

from math import prod
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...base.errors import InputError
from ...scene.resident_triangles import FramedVertices
from ...scene.scene_bounds import MAX_EXTENT
from ...scene.triangle_setup import rows_with_area
from .build_kernels import Source
from .device_kernels import PointBuffer
from .device_launches import DeviceLaunches
from .device_tracer import DeviceTracer
from .device_traversal import PRIM, TRIANGLE, TreeBuffers
from .resident_rays import borrowed, frame_points, is_double
from .tree_build import join_all, keep_tagged, strips_of

_LIMIT = float(np.float32(MAX_EXTENT))


class ResidentVertices:
    """New vertices on the device of a tracer: `scene.resident_triangles.DeviceVertices`.

    tracer : DeviceTracer
    value : array on its device, (n, 3, 3) or (v, 3) float32 or float64, world; read when `in_frame` is called
    """

    def __init__(self, tracer: DeviceTracer, value: Any) -> None:
        self._tracer = tracer
        with tracer.lock:
            self._array = borrowed(value, tracer.device, "vertices")

    @property
    def shape(self) -> tuple[int, ...]:
        return self._array.shape

    def in_frame(self, corners: NDArray[np.int32] | None, origin: NDArray[np.float64], name: str) -> FramedVertices:
        """The triangles in the frame; see `DeviceVertices`. Nothing reads the array afterwards."""
        device, launches, array = self._tracer.device, self._tracer.launches, self._array
        points, n = prod(array.shape) // 3, prod(array.shape) // 9 if corners is None else len(corners) // 3
        with self._tracer.lock:
            memory = device.allocate(36 * n, "the triangles of the scene")
            local = memory if corners is None else launches.block("origins", 12 * points, "the vertices of the scene")
            x, y, z = origin.tolist()
            buffer = PointBuffer(array.address, is_double(array), 3, (x, y, z), 0, _LIMIT)
            faults, vertex, lost = frame_points(buffer, points, local.address, launches)
            if faults:
                raise InputError(
                    f"{name}: vertices hold NaN or infinity, or are over {MAX_EXTENT:g} units from the origin (vertex "
                    f"{vertex})"
                )
            if corners is not None:
                sent = launches.sent("corners", corners, "the faces of the scene")
                launches.launch("gather_points", (local.address, sent, 3 * n, memory.address), 3 * n)
            found = Source(memory.address, 0, n)
            bounds, with_area = surveyed(found, launches)

        def fetch() -> NDArray[np.float32]:
            with self._tracer.lock:
                return memory.read(np.empty((n, 3, 3), np.float32))

        return FramedVertices(memory, fetch, with_area, bounds, not lost)


def surveyed(source: Source, launches: DeviceLaunches) -> tuple[NDArray[np.float32], NDArray[np.int32] | None]:
    """(bounds, with_area) of all triangles of a scene, as from `scene.triangle_setup.survey`."""
    strips, boxes = strips_of(source.n, launches)
    tags = launches.block("tags", 4 * (source.n + 1), "the tags of triangles")
    launches.launch("survey_strips", (source, boxes, strips, tags.address), strips)
    box = join_all(boxes, strips, launches)
    return np.stack([box[:3], -box[4:7]]), _with_area(source.n, keep_tagged(source, tags, launches), launches)


def _with_area(n: int, unsure: Source, launches: DeviceLaunches) -> NDArray[np.int32] | None:
    """The triangles with area among n, if only the area of some is to be decided."""
    if not unsure.n:
        return None
    block = launches.block("unsure", 4 * TRIANGLE * unsure.n, "triangles")
    tree = TreeBuffers(0, block.address, (np.float32(0.0),) * 3)
    launches.launch("write_triangles", (tree, unsure.faces, 1, unsure.vertices, unsure.n), unsure.n)
    words = block.read(np.empty((unsure.n, TRIANGLE), np.float32))
    corners = np.ascontiguousarray(words.reshape(-1, 3, 4)[..., :3])
    decided = rows_with_area(corners, 1)
    if decided is None:
        return None
    has_area = np.ones(n, np.bool_)
    has_area[np.delete(words.view(np.int32)[:, PRIM], decided)] = False
    return np.flatnonzero(has_area).astype(np.int32)
