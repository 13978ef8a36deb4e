"""Scenes in a store: chunks are read on demand when rays reach them, and evicted to stay within a memory budget."""

from collections.abc import Iterator, Sequence
from typing import ClassVar

import numpy as np

from ..checks import byte_count
from ..errors import InputError
from ..methods import BUILDERS
from ..plan import Plan
from ..query.gbuffer import from_hits
from ..query.pixel_refinement import subpixel_rays
from ..query.ray_list import HitArrays, RayArguments, RayArrays, hit_arrays
from ..query.ray_passes import RayPass, camera_pass
from ..query.shadow_query import Surfaces
from ..scene.camera import CameraRays
from ..scene.listed_rays import ListedRays
from ..scene.triangles import Triangles, joined
from ..store.chunk_residency import Copies, Paging, Residency, hit_slots, slot_starts
from ..store.store_file import StoreData
from ..store.system_resources import release_freed, resident
from ..techniques.chcrt.chc_rt import ChcRtState, camera_hits, nearest_hits, prepare, ray_hits
from ..techniques.chcrt.nearest_hits import mark_hits, number_hits
from ..techniques.chcrt.tree_parts import parts_of_chunks
from ..techniques.tracer_options import ChcRtOptions
from ..trace.rays.ray_hits import Nearest, surfaces_met
from ..trace.tree_list import Hits
from .accelerate import Accelerated, Accelerator
from .bands import Bands
from .memory import FrameMemory
from .paged_rays import LEAST, RAY_BYTES, Batch, batches, weights
from .ready import Job, fixed_job, make_ready, small_scene, small_view

MAX_MEMORY = 4 << 30
_CHUNKS_AT_ONCE = 256  # chunks whose triangles are numbered together
_NONE = np.empty(0, np.int64)
_MANY = 4  # neighbouring bands read some chunks twice: they pay where a frame reads so many times the memory
_SPARE = 48 << 20  # bytes reserved for small allocations


def paged_job() -> Job:
    """The additional job of rendering a scene in a store, besides the job of its plan."""

    def work():
        scene, (h, w) = small_scene(), (8, 8)
        scheduled = prepare(BUILDERS["bsah"].build(scene.triangles().vertices, 2), ChcRtOptions(), 2)
        first, view = np.zeros(len(scheduled.parts.trees), np.int64), small_view()[0].rays(scene.origin)
        camera_hits(scheduled, view, 2)
        rays, _ = subpixel_rays(view, np.ones((view.height // 4, view.width // 4), np.bool_), 2)
        (hits,) = nearest_hits(scheduled, [rays], (h, w), 2)
        mark_hits(hits, first, np.zeros(1 << 20, np.uint8), 2)
        faces = np.full((h, w), -1, np.int32)
        number_hits(hits, first, np.zeros(1 << 20, np.int32), faces, 2)
        ray_hits(scheduled, rays, np.tile([0.0, 1.0], (h * w, 1)), 0, False, 2)
        weights(Batch(np.arange(h * w), rays, hits, scene.triangles(), hits.face.reshape(-1)), 2)

    return fixed_job("scenes in a store", work)


class Paged:
    """A scene in a store, with its resident chunks; `RenderSource` documents the methods.

    Parameters
    ----------
    data : StoreData
    accelerator : Accelerator
        Its plan names the tracer for the store's trees.
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
    in_store: ClassVar = True
    looks: ClassVar = 1
    gbuffer = "rays"

    def __init__(self, data: StoreData, accelerator: Accelerator, max_memory: int | None = None):
        plan = accelerator.plan
        if plan.tracer.culling is None or plan.cull or plan.optimise or plan.update or plan.build != Plan().build:
            raise InputError(
                f"plan {str(plan)!r}: {data.name} is in a store, whose trees are built; use {self.default_plan}"
            )
        most = MAX_MEMORY if max_memory is None else byte_count(max_memory, "max_memory", 1)
        store = data.store
        self.scene, self.threads, self.max_memory = data, accelerator.threads, most
        self.store, self.residency = store, Residency(store, most)
        self._before: Paging | None = None  # when the frame began
        self._room = 0
        self._together: dict[int, int] = {}  # size -> how many were traced together
        self._bands, self._looked = Bands(), 0  # bytes read when the last camera rays had been traced
        self._reads = int(store.chunks.bytes.sum())  # bytes that the last frame read; at first those of the store
        parts = parts_of_chunks(store.top.nodes, store.chunks.root, self.residency.trees, self.residency, store)
        scheduled = ChcRtState(parts, plan.tracer.culling)
        self.accelerated: Accelerated = Accelerated(self._triangles(), None, scheduled)

    def warm_up(self) -> None:
        make_ready(paged_job)

    def begin(self, memory: FrameMemory) -> None:
        """Begin a frame. Its rays that are asked together get up to half of the memory, and the chunks the rest."""
        self.residency.begin_question()  # before memory is measured
        release_freed()
        free = self.budget(memory)
        together, cells = min(free // 2, memory.passes), min(free // 8, memory.cells)
        self._room, self.accelerated.prepared.room = together, cells
        if self._before is not None:
            self._reads = self.residency.paging.bytes - self._before.bytes
        self.residency.budget, self._before = free - together - cells, self.residency.paging
        self.residency.trim()

    def release(self) -> None:
        """Leave the memory of all chunks to others."""
        self.residency.budget = 0
        self.residency.trim()

    def together(self, size: int) -> int:
        n, kept = self.at_once(size), self._together.get(size, 0)
        if 3 * n <= 4 * kept <= 5 * n:  # as in the frame before: its states are of the same questions
            return kept
        self._together[size] = n
        return n

    def at_once(self, size: int) -> int:
        return max(1, self._room // 2 // max(size, 1))

    def budget(self, memory: FrameMemory) -> int:
        """Bytes left for chunks, and for rays that are asked together, in a frame.

        Raises
        ------
        InputError
            If the budget does not hold two chunks and the least of such rays.
        """
        free = self.max_memory - memory.fixed - _SPARE - (resident() - self.residency.held)
        least = self.residency.least_budget() * 2
        if free < least:
            need = -(-(self.max_memory - free + least) >> 20)
            raise InputError(
                f"{self.scene.name}: {self.max_memory >> 20}M of memory is not enough for so many pixels or "
                f"points; give at least {need}M, or ask for fewer"
            )
        return free

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
        assert before is not None
        return {name: a - b for name, a, b in zip(now._fields, now, before)}

    def bands(self, height: int) -> Iterator[slice]:
        budget = self.residency.budget
        for rows in self._bands.of_frame(height, self._reads > _MANY * budget):
            before = self.residency.paging.bytes
            yield rows
            self._bands.read(self._looked - before, self.residency.paging.bytes - self._looked, budget)

    def look(self, camera, triangles=None, whole=None, progress=None, rows: slice | None = None) -> Surfaces:
        """The surfaces that a camera sees; `triangles` and `whole` are not used."""
        if camera.listed:
            rows = rows or slice(0, camera.height)
            passes, shape = [camera_pass(camera.view(self.scene.origin), rows)], (rows.stop - rows.start, camera.width)
            found = nearest_hits(self.accelerated.prepared, passes, shape, self.threads, progress)
            surfaces = next(self._met(passes, found, shape))
            self._looked = self.residency.paging.bytes
            return surfaces
        rays = camera.rays(self.scene.origin)
        hits = camera_hits(self.accelerated.prepared, rays, self.threads, progress, rows)
        triangles, (face,) = self.hit_triangles([hits])
        gbuffer = from_hits(face, hits.t, triangles, rays, self.threads, rows.start if rows else 0)
        self._looked = self.residency.paging.bytes
        return Surfaces(gbuffer, triangles, hits.face, self.store.meta.box)

    def nearest_in(self, whole: Accelerated) -> Nearest:
        return self.nearest

    def nearest(
        self, passes: Sequence[RayPass], shape: tuple[int, int], by: ChcRtState | None = None
    ) -> Iterator[Surfaces]:
        """The first surfaces that each of some passes of rays meets. Each chunk is read once for all of them.

        shape : (H, W) of the picture
        by : another tracer of the same parts; None: the plan's tracer
        """
        return self._met(passes, nearest_hits(by or self.accelerated.prepared, passes, shape, self.threads), shape)

    def _met(self, passes: Sequence[RayPass], hits: Sequence[Hits], shape: tuple[int, int]) -> Iterator[Surfaces]:
        """Yield the surfaces of the hits of passes, the question that has just ended."""
        triangles, faces = self.hit_triangles(hits)
        for rays, met, face in zip(passes, hits, faces):
            gbuffer = surfaces_met(rays, face.reshape(-1), met.t.reshape(-1), shape, triangles, self.threads)
            yield Surfaces(gbuffer, triangles, met.face, self.store.meta.box)

    def trace_rays(self, rays: RayArguments, any_hit: bool, time: float, threads: int | None = None) -> HitArrays:
        """`threads` is not used: those of the engine trace."""
        arrays, out = rays.arrays(), hit_arrays(rays.n, any_hit)
        for batch in self._batches(arrays, any_hit, rays.cull_faces):
            at, hits = batch.places, batch.hits
            if any_hit:
                out.blocked[at] = hits.face[0] >= 0
            else:
                out.face[at], out.t[at] = hits.face[0], hits.t[0]
                out.u[at], out.v[at] = weights(batch, self.threads)
        return out

    def triangles_hit(self, rays: RayArguments, face: np.ndarray, time: float) -> tuple[Triangles, np.ndarray]:
        """The same rays find the triangles again: a store has none in memory."""
        faces, found, n = np.full(rays.n, -1), [], 0
        for batch in self._batches(rays.arrays(), False, rays.cull_faces):
            faces[batch.places] = np.where(batch.faces >= 0, batch.faces + n, -1)
            found.append(batch.triangles)
            n += len(batch.triangles.vertices)
        self.release()  # such questions are rare
        return joined(found or [self.accelerated.triangles]), faces.reshape(face.shape)

    def _batches(self, rays: RayArrays, any_hit: bool, cull_faces: int) -> Iterator[Batch]:
        rays.check()
        m = len(rays.origins)
        self.begin(FrameMemory(0, 0, 2 * m * RAY_BYTES))
        self.accelerated.begin()
        return batches(self, rays, any_hit, cull_faces, max(self.together(RAY_BYTES), LEAST))

    def subpixels(
        self, triangles: Triangles, view: CameraRays | ListedRays, edge: np.ndarray, whole: Accelerated | None = None
    ) -> Surfaces:
        """`triangles` and `whole` are not used: rays find the surfaces."""
        rays, shape = subpixel_rays(view, edge, self.threads)
        return next(self.nearest([rays], shape))

    def hit_triangles(self, hits: Sequence[Hits]) -> tuple[Triangles, list[np.ndarray]]:
        """Copies of the triangles that rays hit, each once; and for each of `hits` (h, w) int32 indices of them or -1.

        `hits` are those of the question that has just ended.
        """
        parts = np.zeros(len(self.store), np.bool_)
        for each in hits:
            parts[np.unique(each.part[each.part >= 0])] = True

        def mark(first: np.ndarray, marks: np.ndarray) -> None:
            for each in hits:
                mark_hits(each, first, marks, self.threads)

        faces, copies, n = [np.full(each.part.shape, -1, np.int32) for each in hits], list[Copies](), 0
        chunks, sizes = np.flatnonzero(parts), self.store.chunks.triangles
        for begin in range(0, len(chunks), _CHUNKS_AT_ONCE):
            some = chunks[begin : begin + _CHUNKS_AT_ONCE]
            first, numbers = slot_starts(some, sizes), np.zeros(int(sizes[some].sum()), np.int32)
            for k, slots in hit_slots(some, sizes, mark):
                numbers[first[k] + slots] = np.arange(n, n + len(slots), dtype=np.int32)
                copies.append(self.residency.triangles(k, slots))
                n += len(slots)
            for each, face in zip(hits, faces):
                number_hits(each, first, numbers, face, self.threads)
        return self._triangles(copies), faces

    def _triangles(self, copies: Sequence[Copies] = ()) -> Triangles:
        """Copied triangles in one `Triangles`; never empty, since kernels may read the first entry."""
        none = Copies(_NONE, np.zeros((1, 3, 3), np.float32), np.zeros((1, 3), np.float32), np.zeros(1, np.int32))
        _, vertices, colour, ids = (np.concatenate(arrays) for arrays in zip(*(copies or [none])))
        return Triangles(vertices, self.scene.origin.copy(), ids, colour)
