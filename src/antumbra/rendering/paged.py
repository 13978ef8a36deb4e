"""Scenes in a store: chunks are read on demand when rays reach them, and evicted to stay within a memory budget."""

from functools import partial
from typing import ClassVar

import numpy as np

from ..bvh.radix_sort import radix_sort
from ..chcrt.parts import parts_of_chunks
from ..chcrt.trace import Scheduled, camera_hits, nearest_hits
from ..checks import whole_number
from ..errors import InputError
from ..plan import Plan
from ..query.diffuse import RayPass
from ..query.gbuffer import from_hits
from ..query.picture import Surfaces
from ..scene.triangles import Triangles
from ..store.residency import Residency
from ..store.resident import resident
from ..store.scene import PagedScene
from ..trace.forest import Hits
from ..trace.rays.bounce import Nearest, surfaces_met
from .accelerate import Accelerated, Accelerator
from .ready import Job, fixed_job, make_ready

MAX_MEMORY = 4 << 30
_PIXEL_BYTES = 320  # bytes per pixel of a frame's arrays: rays, hits, surfaces, cells, the image and its inputs
_SPARE = 48 << 20  # bytes reserved for small allocations


def paged_job() -> Job:
    """The additional job of rendering a scene in a store, besides the job of its plan."""
    work = lambda: radix_sort(np.zeros(2, np.int64), np.zeros(2, np.int32), 40, 2)
    return fixed_job("scenes in a store", work)


class Paged:
    """A scene in a store, with its resident chunks; `RenderSource` documents the methods.

    Parameters
    ----------
    scene : PagedScene
    accelerator : Accelerator
        Its plan names the tracer for the store's trees.
    gbuffer : str
        Has no effect: primary visibility in a store always uses rays. They give the same bits as rasterisation.
    max_memory : int or None
        Limit in bytes on the memory of the process at any time; None: 4 GiB.

    Attributes
    ----------
    accelerated : Accelerated
        The input of the plan's tracer; it holds no triangles.
    residency : Residency
        Tracks which chunks are in memory.

    Raises
    ------
    InputError
        If the plan needs all triangles, or `max_memory` is out of range.
    """

    default_plan: ClassVar = str(Plan(trace="chcrt"))
    keeps_read: ClassVar = True
    looks: ClassVar = 1
    gbuffer = "rays"

    def __init__(
        self, scene: PagedScene, accelerator: Accelerator, gbuffer: str = "rays", max_memory: int | None = None
    ):
        plan = accelerator.plan
        if plan.tracer.culling is None or plan.cull or plan.optimise or plan.update or plan.build != Plan().build:
            raise InputError(
                f"plan {str(plan)!r}: {scene.name} is in a store, whose trees are built; use {self.default_plan}"
            )
        most = MAX_MEMORY if max_memory is None else whole_number(max_memory, "max_memory", 1, 1 << 60)
        store = scene.store
        self.scene, self.threads, self.max_memory = scene, accelerator.threads, most
        self.store, self.residency = store, Residency(store, most)
        self._before = self.residency.paging
        parts = parts_of_chunks(store.top.nodes, store.chunks.root, self.residency.trees, self.residency, store)
        scheduled = Scheduled(parts, plan.tracer.culling)
        self.accelerated: Accelerated = Accelerated(self._triangles(np.empty((0, 2), np.int32)), None, scheduled)

    def warm_up(self) -> None:
        make_ready(paged_job)

    def check_adaptive(self) -> None:
        raise InputError(f"{self.scene.name}: adaptive sampling wants all triangles at once; leave it out")

    def begin(self, pixels: int, words: int) -> None:
        """Begin a frame of `pixels` pixels with `words` words of bits each; the chunks get the remaining memory."""
        self.residency.budget, self._before = self.budget(pixels, words), self.residency.paging
        self.residency.trim()

    def budget(self, pixels: int, words: int) -> int:
        """Bytes left for chunks in a frame of `pixels` pixels with `words` words of bits each.

        Raises
        ------
        InputError
            If the budget does not hold two chunks.
        """
        frame = pixels * (_PIXEL_BYTES + 8 * words) + _SPARE
        budget = self.max_memory - frame - (resident() - self.residency.used)
        least = self.residency.least_budget()
        if budget < least:
            need = -(-(self.max_memory - budget + least) >> 20)
            raise InputError(
                f"{self.scene.name}: {self.max_memory >> 20}M of memory is not enough for so many pixels or "
                f"points; give at least {need}M, or ask for fewer"
            )
        return budget

    def moment(self, time: float) -> tuple[Triangles, Accelerated]:
        return self.accelerated.triangles, self.accelerated

    for_points = moment

    def keep(self, accelerated: Accelerated) -> None:
        pass

    def box(self, triangles: Triangles) -> np.ndarray:
        return self.store.meta.box

    def paging(self) -> dict[str, int]:
        """Counts of chunks read and evicted in this frame."""
        now, before = self.residency.paging, self._before
        return {name: a - b for name, a, b in zip(now._fields, now, before)}

    def look(self, camera, triangles=None, whole=None, progress=None) -> Surfaces:
        """The surfaces that a camera sees; `triangles` and `whole` are not used."""
        rays = camera.rays(self.scene.origin)
        return self._surfaces(
            camera_hits(self.accelerated.prepared, rays, self.threads, progress),
            lambda face, t, triangles: from_hits(face, t, triangles, rays, self.threads),
        )

    def nearest_in(self, whole: Accelerated) -> Nearest:
        return self.nearest

    def nearest(self, rays: RayPass, shape: tuple[int, int], by: Scheduled | None = None) -> Surfaces:
        """The first surfaces that a pass of rays meets.

        shape : (H, W) of the picture
        by : another tracer of the same parts; None: the plan's tracer
        """
        (hits,) = nearest_hits(by or self.accelerated.prepared, [rays], shape, self.threads)
        return self._surfaces(hits, partial(self._met, rays, shape))

    def _met(self, rays, shape, face, t, triangles):
        return surfaces_met(rays, face.reshape(-1), t.reshape(-1), shape, triangles, self.threads)

    def _surfaces(self, hits: Hits, gbuffer_of) -> Surfaces:
        """Surfaces at the hits; only the hit triangles are copied from their chunks."""
        seen = hits.part >= 0
        where = hits.part[seen].astype(np.int64) << 32 | hits.slot[seen]
        bits = 32 + len(self.store).bit_length()
        where, order = radix_sort(where, np.arange(len(where), dtype=np.int32), bits, self.threads)
        first = np.diff(where, prepend=-1) != 0
        numbers = np.empty(len(where), np.int32)
        numbers[order] = np.cumsum(first, dtype=np.int32) - 1
        face = np.full(seen.shape, -1, np.int32)
        face[seen] = numbers
        triangles = self._triangles(np.stack([where[first] >> 32, where[first] & 0xFFFFFFFF], 1))
        return Surfaces(gbuffer_of(face, hits.t, triangles), triangles, hits.face, self.store.meta.box)

    def _triangles(self, where: np.ndarray) -> Triangles:
        """Copies of triangles; `where`: (n, 2) int64, chunk and slot of each, sorted by chunk."""
        n = max(len(where), 1)  # never empty: kernels may read the first entry
        vertices, colour, ids = np.zeros((n, 3, 3), np.float32), np.zeros((n, 3), np.float32), np.zeros(n, np.int32)
        starts = np.flatnonzero(np.diff(where[:, 0], prepend=-1))
        for first, end in zip(starts, np.append(starts[1:], len(where))):
            k, slots = int(where[first, 0]), where[first:end, 1]
            chunk = self.store.chunk(k)
            vertices[first:end] = chunk.bvh.corners[slots].reshape(-1, 3, 3)
            colour[first:end] = chunk.palette[chunk.index[slots]]
            ids[first:end] = chunk.bvh.prim_ids[slots]
            if k not in self.residency:
                self.store.release(k)
        return Triangles(vertices, self.scene.origin.copy(), ids, colour)
