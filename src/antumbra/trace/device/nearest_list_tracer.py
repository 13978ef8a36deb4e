"""Nearest hits of the rays of screen tiles on a device, through the trees that each tile lists, as in a `TreeList`.

Rays and their hits so far stay there from call to call. A call returns only new hits, so that occlusion queries on the
CPU know how far each ray reaches. The CPU decides single tests by the corners in their records.
"""

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...devices.device import DeviceMemory
from ...kernels.exact.filters import hit_t, meets, signed_t
from ...kernels.jit import kernel
from ...kernels.parallel import items, new_ticket, run
from ...kernels.simd import ptr
from ...scene.camera import CameraRays
from ..tree_list import Hits
from . import settling
from .device_kernels import RECORD
from .device_rays import RayBuffers
from .device_surfaces import pixels_of
from .device_traversal import COUNTS, REST, WON, Work
from .nearest_list_kernels import HIT_WORDS, STATE_WORDS, ListedRays
from .tree_list_kernels import CORNERS
from .tree_list_tracer import TiledTracer, TreeLists

AT_ONCE = 1 << 20
"""Largest number of rays traced together, with 32 bytes for a new hit each."""

_CHUNK = 64
_HIT = np.dtype(
    [("signed_t", "<f8"), ("t", "<f8"), ("ray", "<i4"), ("face", "<i4"), ("item", "<i4"), ("slot", "<i4")]
)  # HIT_WORDS


class RayGrid(NamedTuple):
    """How the pixels of a picture are cut into screen tiles, as in `TreeList`, and which rows of them have rays."""

    pixels: int  # side of a tile
    across: int  # tiles per row
    shape: tuple[int, int]  # of the picture
    rows: slice


class RayVectors(NamedTuple):
    """One ray per pixel on the host, as in `RayBuffers`."""

    origins: NDArray[np.float32]  # (n, 3)
    directions: NDArray[np.float32]  # (n, 3)
    skip: NDArray[np.int32]  # (n,)
    spans: NDArray[np.float64]  # (n, 2): tmin and tmax; or (1, 2) for all rays
    cull_faces: int


class TiledRays:
    """The rays of some rows of pixels on a device, and their nearest hits so far.

    Memory is reserved for all that tracing needs, except for lists of trees.

    tracer : TiledTracer
    grid : RayGrid
    rays : RayVectors; or CameraRays, which are written there
    hits : Hits
        On the host, of all pixels; updated by `trace_nearest`.

    Raises
    ------
    OutOfDeviceMemory
        If they do not fit.
    """

    def __init__(self, tracer: TiledTracer, grid: RayGrid, rays: RayVectors | CameraRays, hits: Hits) -> None:
        self.tracer, self.grid, self.hits, self._memory = tracer, grid, hits, list[DeviceMemory]()
        self._is_seen = isinstance(rays, CameraRays)
        self.cull_faces = 0 if isinstance(rays, CameraRays) else rays.cull_faces
        (height, width), rows = grid.shape, grid.rows
        self._tile_rows, n = min(grid.pixels, height), (rows.stop - rows.start) * width
        with tracer.lock:
            allocate = tracer.launches.allocate
            self._state = allocate(4 * STATE_WORDS * n, "the nearest hits of rays")
            self._state.fill()
            self._buffers = self._seen(rays, n) if isinstance(rays, CameraRays) else self._sent(rays)
            per_tile = self._tile_rows * grid.pixels
            _nearest_work(tracer, 0, min(per_tile * grid.across * -(-height // grid.pixels), AT_ONCE), 0)

    def _seen(self, rays: CameraRays, n: int) -> RayBuffers:
        launches, rows = self.tracer.launches, self.grid.rows
        self._memory = [launches.allocate(12 * n, "the rays") for _ in range(2)]
        origins, ends = (memory.address for memory in self._memory)
        launches.launch("write_pixel_rays", (pixels_of(rays, rows.start * rays.width, n), origins, ends), n)
        return RayBuffers(origins, ends, 0, 0, 0, 0, 0.0, np.inf, -1)

    def _sent(self, rays: RayVectors) -> RayBuffers:
        (shared_tmin, shared_tmax), spans = rays.spans[0], [0, 0]
        arrays: list[NDArray[Any]] = [rays.origins, rays.directions, rays.skip]
        if len(rays.spans) > 1:
            arrays += [rays.spans[:, 0], rays.spans[:, 1]]
        self._memory = [self.tracer.launches.upload(np.ascontiguousarray(a), "the rays") for a in arrays]
        origins, ends, skip, *own = (memory.address for memory in self._memory)
        tmin, tmax = own or spans
        return RayBuffers(origins, ends, tmin, tmax, skip, 0, float(shared_tmin), float(shared_tmax), -1)

    def on_tiles(self, tiles: int) -> ListedRays:
        """The rays of tiles; tiles: the address of their numbers, int32."""
        grid, (_, width) = self.grid, self.grid.shape
        return ListedRays(
            self._buffers, self._state.address, tiles, grid.pixels, self._tile_rows, grid.across, width,
            grid.rows.start, grid.rows.stop,
        )  # fmt: skip

    def trace_nearest(
        self, tiles: NDArray[np.int32], lists: TreeLists, numbers: NDArray[np.int32], threads: int
    ) -> None:
        """Trace the rays of some tiles through their lists, and update `hits`.

        numbers : (k,): the part that each row of the lists' table is
        """
        tracer, launches = self.tracer, self.tracer.launches
        n, begin, at_once, parts = len(tiles) * self._tile_rows * self.grid.pixels, 0, AT_ONCE, numbers[lists.items]
        with tracer.lock:
            sent = tracer.sent_lists(lists, 0)
            tiled = self.on_tiles(launches.sent("tiles", tiles, "the lists of tiles"))
            while begin < n:
                work = _nearest_work(tracer, begin, min(at_once, n - begin), self.cull_faces)
                counts = launches.block("counts", 0, "")
                counts.fill()
                launches.launch("find_listed", (sent._replace(corners=tracer.records().corners), tiled, work), work.n)
                counted = counts.read(np.empty(COUNTS, np.int32))
                self._keep(launches.block("new hits", 0, "").read(np.empty(counted[WON], _HIT)), parts)
                left = int(counted[REST])
                if left > work.rest_capacity:  # the hits so far stay
                    at_once = max(work.n // 2, 1)
                    tracer.widen_records(2 * work.rest_capacity if work.n == 1 else 0)
                    continue
                if left:
                    self._decide(left, parts, threads)
                begin, at_once = begin + work.n, min(2 * at_once, AT_ONCE)

    def _keep(self, found: NDArray[np.void], parts: NDArray[np.int32]) -> None:
        """Write new hits to the arrays on the host; parts: of the items of the lists."""
        at, hits = found["ray"] + self.grid.rows.start * self.grid.shape[1], self.hits
        signed = found["signed_t"]
        for array, values in (
            (hits.signed_t, signed), (hits.t, found["t"] if self._is_seen else np.abs(signed)),
            (hits.face, found["face"]), (hits.part, parts[found["item"]]), (hits.slot, found["slot"]),
        ):  # fmt: skip
            array.reshape(-1)[at] = values

    def _decide(self, left: int, parts: NDArray[np.int32], threads: int) -> None:
        """Decide recorded tests, and send the hits that precede those so far."""
        tracer, hits = self.tracer, self.hits
        tracer.on_cpu += left
        records = tracer.launches.block("rest", 0, "").read(np.empty((left, RECORD)))
        corners = tracer.launches.block("corners", 0, "").read(np.empty((left, CORNERS), np.float32))
        found = _hits_of(records, *numbers_of(records, corners, self.cull_faces, threads))
        at = found["ray"] + self.grid.rows.start * self.grid.shape[1]
        face = hits.face.reshape(-1)[at]
        t, known = found["signed_t"], np.where(face >= 0, hits.signed_t.reshape(-1)[at], np.inf)
        same = np.where(t == known, found["face"] < face, t > known)
        found = found[np.where(np.abs(t) != np.abs(known), np.abs(t) < np.abs(known), same)]  # `filters.precedes`
        self._keep(found, parts)
        words = np.stack([*found["signed_t"].copy().view(np.int32).reshape(-1, 2).T, found["face"] + 1], 1)
        places = STATE_WORDS * found["ray"].astype(np.int64)[:, None] + np.arange(3)
        tracer.launches.mark(self._state.address, places.reshape(-1), words.reshape(-1))


def _nearest_work(tracer: TiledTracer, first: int, n: int, cull_faces: int) -> Work:
    """The `Work` of n rays: `out` is the list of new hits, and there are no undecided tests but records."""
    records, launches = tracer.records(), tracer.launches
    counts = launches.block("counts", 4 * COUNTS, "counts")
    out = launches.block("new hits", 4 * HIT_WORDS * n, "the answers")
    return Work(first, n, 0, out.address, counts.address, 0, 0, records.rest, records.capacity, cull_faces)


# --- What the CPU decides ---------------------------------------------------------------------------------------------


@kernel
def _decide_tests(ticket, records, heads, corners, cull_faces, signed, t):
    # In: records and their heads, corners of triangles, cull_faces. Out: signed, t
    triangles = ptr(corners)
    for k in items(ticket):
        ray = settling.ray_of(records, k)
        side = meets(ray, triangles, k)
        signed[k] = t[k] = np.inf
        if side != 0 and side != cull_faces:
            signed[k], t[k] = signed_t(ray, triangles, k), hit_t(ray, triangles, k)


def numbers_of(
    records: settling.Records, corners: NDArray[np.float32], cull_faces: int, threads: int
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """The `filters.signed_t` and the `filters.hit_t` of the hits that records are, (m,) each; inf: a miss."""
    signed, t, heads = np.empty(len(records)), np.empty(len(records)), settling.heads_of(records)
    run(_decide_tests, threads, new_ticket(len(records), _CHUNK), records, heads, corners, cull_faces, signed, t)
    return signed, t


def _hits_of(records: settling.Records, signed: NDArray[np.float64], t: NDArray[np.float64]) -> NDArray[np.void]:
    """The first hit of each ray that has one among its records, by `filters.precedes`."""
    ray, slot, item, face = settling.heads_of(records).T
    order = np.lexsort([face, signed < 0, np.abs(signed), ray])
    order = order[np.isfinite(signed[order])]
    first = order[np.append(True, ray[order][1:] != ray[order][:-1])[: len(order)]]
    found = np.empty(len(first), _HIT)
    for name, values in zip(_HIT.names or (), (signed, t, ray, face, item, slot)):
        found[name] = values[first]
    return found
