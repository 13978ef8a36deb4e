"""Scenes in a store: what a `Renderer` does otherwise where not all triangles are in memory."""

from functools import partial
from typing import TYPE_CHECKING

import numpy as np

from ..bvh.radix_sort import radix_sort
from ..chcrt.parts import parts_of_chunks
from ..chcrt.trace import Scheduled, camera_hits, nearest_hits
from ..checks import whole_number
from ..errors import InputError
from ..plan import DEFAULT_PLAN, Plan
from ..query.diffuse import RayPass
from ..query.gbuffer import from_hits
from ..query.picture import Surfaces
from ..scene.triangles import Triangles
from ..store.resident import resident
from ..trace.forest import Hits
from ..trace.rays.bounce import surfaces_met
from .accelerate import Accelerated

if TYPE_CHECKING:
    from ..store.read import Store

MAX_MEMORY = 4 << 30
_PIXEL_BYTES = 320  # of a frame's arrays: rays, hits, surfaces, cells, the image and what makes it
_SPARE = 48 << 20  # for what is allocated here and there


def is_paged(scene) -> bool:
    """Is the scene in a store?"""
    return hasattr(scene, "store")


def default_plan(scene) -> str:
    """The plan that a scene is rendered by if none is given."""
    return str(Plan(trace="chcrt")) if is_paged(scene) else DEFAULT_PLAN


def paged(scene, plan: Plan, threads: int, max_memory: int | None) -> "Paged | None":
    """What renders a scene in a store; None: all triangles are in memory.

    Raises
    ------
    InputError
        On a plan that needs all triangles, or a `max_memory` for what is in memory anyway.
    """
    if not is_paged(scene):
        if max_memory is not None:
            raise InputError(f"max_memory is for scenes in a store, and {scene.name} is in memory; leave it out")
        return None
    given = [name for name in (plan.cull, plan.optimise, plan.update) if name]
    if plan.tracer.culling is None or given or plan.build != Plan().build:
        raise InputError(
            f"plan {str(plan)!r}: {scene.name} is in a store, whose trees are built; use {Plan(trace='chcrt')}"
        )
    most = MAX_MEMORY if max_memory is None else whole_number(max_memory, "max_memory", 1, 1 << 60)
    return Paged(scene, plan, threads, most)


class Paged:
    """A scene in a store, with those of its chunks that are in memory.

    accelerated : Accelerated
        What the plan's tracer takes; its triangles are none.
    residency : store.residency.Residency
    """

    def __init__(self, scene, plan: Plan, threads: int, max_memory: int):
        from ..store.residency import Residency

        self.scene, self.threads, self.max_memory = scene, threads, max_memory
        store: Store = scene.store
        self.store, self.residency = store, Residency(store, max_memory)
        self._before = self.residency.paging
        parts = parts_of_chunks(store.top.nodes, store.chunks.root, self.residency.trees, self.residency, store)
        assert plan.tracer.culling is not None  # `paged` has looked
        scheduled = Scheduled(parts, plan.tracer.culling)
        self.accelerated: Accelerated = Accelerated(self._triangles(np.empty((0, 2), np.int32)), None, scheduled)

    def begin(self, pixels: int, words: int) -> None:
        """A frame of so many pixels and words of bits begins: the chunks get what memory it leaves."""
        self.residency.budget, self._before = self.budget(pixels, words), self.residency.paging
        self.residency.trim()

    def budget(self, pixels: int, words: int) -> int:
        """Bytes that chunks may take in such a frame.

        Raises
        ------
        InputError
            If that is not enough for two chunks.
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

    def paging(self) -> dict[str, int]:
        """What has come and gone in this frame."""
        now, before = self.residency.paging, self._before
        return {name: a - b for name, a, b in zip(now._fields, now, before)}

    def look(self, camera, progress=None) -> Surfaces:
        """The surfaces that a camera sees."""
        rays = camera.rays(self.scene.origin)
        return self._surfaces(
            camera_hits(self.accelerated.prepared, rays, self.threads, progress),
            lambda face, t, triangles: from_hits(face, t, triangles, rays, self.threads),
        )

    def nearest(self, rays: RayPass, shape: tuple[int, int], by: Scheduled | None = None) -> Surfaces:
        """The surfaces that a pass of rays over a picture of this shape meets first, traced by the plan's tracer or by
        another one of the same parts."""
        hits = nearest_hits(by or self.accelerated.prepared, rays, shape, self.threads)
        return self._surfaces(hits, partial(self._met, rays, shape))

    def _met(self, rays, shape, face, t, triangles):
        return surfaces_met(rays, face.reshape(-1), t.reshape(-1), shape, triangles, self.threads)

    def _surfaces(self, hits: Hits, gbuffer_of) -> Surfaces:
        """The triangles that are hit are copied from their chunks; the others need not be known."""
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
        """Triangles by chunk and slot, (n, 2), in the order of the chunks."""
        n = max(len(where), 1)  # kernels may read the first
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
