"""Scenes in a store: chunks are read when rays reach them, and evicted to stay within a memory budget.

Images are traced in bands of rows, and ray lists in batches of coherent rays, so that each chunk is read once per band
or batch.

A flight over a large city needs more chunks than fit in memory. If all camera rays were traced before all shadow rays,
both would read every chunk. The chunks of a band fit in memory, so its shadow rays reuse those of its camera rays
[Mattausch et al. 2015, Sec. 5.4].
"""

from collections.abc import Iterator, Sequence
from functools import partial
from typing import ClassVar, NamedTuple, NoReturn, cast

import numpy as np
from numpy.typing import NDArray

from ...base.checks import byte_count
from ...base.errors import InputError
from ...kernels.exact.filters import single_weights
from ...kernels.exact.predicate import ray_along
from ...kernels.jit import kernel
from ...kernels.parallel import items, new_ticket, run
from ...query.gbuffer import from_hits
from ...query.pixel_refinement import subpixel_rays
from ...query.query_bounds import morton_codes
from ...query.ray_list import RayArguments, RayArrays, TracedRays, changed_error, hit_arrays
from ...query.ray_passes import RayPass, camera_pass
from ...query.shadow_query import Surfaces
from ...scene.camera import ExplicitRays
from ...scene.scene_data import SceneData
from ...scene.triangles import AllHits, Triangles, concatenate
from ...store.chunk_residency import Paging, Residency, TriangleCopies, hit_slots, slot_starts
from ...store.store_file import StoreData
from ...store.system_resources import release_freed, resident_memory
from ...techniques.chcrt.chc_rt import ChcRtState, camera_hits, nearest_hits, ray_hits
from ...techniques.chcrt.chcrt_tracer import ChcRtTracer
from ...techniques.chcrt.nearest_hits import mark_hits, number_hits
from ...techniques.chcrt.tree_parts import parts_of_chunks
from ...trace.rays.all_hits import INSIDE
from ...trace.rays.local_rays import LocalRays, local_rays
from ...trace.rays.ray_hits import hit_surfaces
from ...trace.tree_list import Hits
from ..accelerator import Accelerated, Accelerator, SceneTrees
from ..plan import Plan
from ..precompilation import precompile
from ..primary_visibility import RAYS
from .paged_hits import all_hits, count_hits
from .source_protocols import Bodies, CameraView, FrameMemory, SourceSettings

# --- Bands of rows ----------------------------------------------------------------------------------------------------


_MIN_ROWS = 16  # the rows of a region
_FIRST_ROWS = 64  # rows of the first band
_CAMERA_SHARE = 0.5  # share of memory that the chunks of a band's camera rays may fill
_SHADOW_SHARE = 0.1  # share of memory that a band's shadow rays may read in any case
_PAUSE_FRAMES = 16  # frames without bands after bands have not helped


class Bands:
    """Chooses the bands of each frame from the bytes read for earlier bands."""

    def __init__(self) -> None:
        self._fitting_bands: dict[int, int] = {}  # first row -> rows, of the last frame's bands that fit in memory
        self._rows = _FIRST_ROWS
        self._pause = 0

    def of_frame(self, height: int, needed: bool) -> Iterator[slice]:
        """Yield the rows of each band from top to bottom. The caller calls `read` after each.

        needed : whether the chunks of the whole image far exceed memory; otherwise, there is a single band
        """
        self._pause -= 1
        banded = needed and self._pause <= 0
        first, fitting, self._fitting_bands = 0, self._fitting_bands if banded else {}, {}
        self._rows = _FIRST_ROWS if banded else height
        while first < height:
            rows = self._rows = min(fitting.get(first, self._rows), height - first)
            yield slice(first, first + rows)
            if self._fit:
                self._fitting_bands[first] = rows
            first += rows

    def read(self, camera_bytes: int, shadow_bytes: int, budget: int) -> None:
        """Choose the rows of the next band.

        camera_bytes, shadow_bytes : bytes read by the camera rays and by the shadow rays of the last band
        budget : limit in bytes on the chunks in memory
        """
        best = self._rows * _CAMERA_SHARE * budget / max(camera_bytes, 1)
        self._fit = shadow_bytes <= max(camera_bytes / 2, _SHADOW_SHARE * budget)
        if self._fit:
            self._rows = _regions(min(2 * self._rows, best))
        elif self._rows > _MIN_ROWS:
            self._rows = _regions(min(self._rows / 2, best))
        else:  # the chunks of even the smallest band do not fit in memory
            self._rows, self._pause = 1 << 30, _PAUSE_FRAMES


def _regions(rows: float) -> int:
    """Round down to the rows of whole regions; at least one region."""
    return max(int(rows) // _MIN_ROWS, 1) * _MIN_ROWS


# --- Ray lists: batches of coherent rays ------------------------------------------------------------------------------


_MIN_EXPONENT = 0  # shorter directions are scaled up


RAY_BYTES = 168
"""Memory of a ray while it is traced."""

MIN_BATCH = 1 << 16
"""Minimum size of a batch, except the last: in smaller ones, each chunk would be read for few rays."""


class HitBatch(NamedTuple):
    """A batch of rays of a list, and their hits."""

    places: NDArray[np.int64]  # (n,): index of each ray in the list
    rays: RayPass
    hits: Hits  # (1, n)
    triangles: Triangles  # the triangles hit; empty for any-hit
    faces: NDArray[np.int32]  # (n,): index of each hit's triangle in `triangles`, or -1


class BatchSettings(NamedTuple):
    """How the rays of a list are traced."""

    any_hit: bool
    cull_faces: int  # a value of CULL_FACES
    max_rays: int  # traced at a time
    threads: int


def trace_batches(paged: "Paged", arguments: RayArrays, settings: BatchSettings) -> Iterator[HitBatch]:
    """Trace the rays of a list, batch by batch."""
    any_hit, cull_faces, max_rays, threads = settings
    order = _coherent_order(arguments)
    for begin in range(0, len(order), max_rays):
        places = order[begin : begin + max_rays]
        part = arguments.part(places)
        rays, spans = part.rays(), np.concatenate([part.tmin, part.tmax], 1, dtype=np.float64)
        rays, factors = _lengthened(rays)
        targets = part.local()[1] if part.segments else None
        if not (np.isfinite(rays.origins).all() and np.isfinite(part.local()[1]).all()):
            raise changed_error()  # they were valid when they were checked
        with np.errstate(over="ignore", under="ignore"):  # such bounds are beyond any t
            spans = spans / factors
        hits = ray_hits(paged.accelerated.prepared, rays, spans, cull_faces, any_hit, threads, targets)
        hits = hits._replace(t=hits.t * factors.T)
        if any_hit:
            yield HitBatch(places, rays, hits, paged.accelerated.triangles, hits.face[0])
        else:
            triangles, (faces,) = paged.hit_triangles([hits], threads)
            yield HitBatch(places, rays, hits, triangles, faces[0])


def _coherent_order(arguments: RayArrays) -> np.ndarray:
    """The order of rays by the Morton codes of their origins, then of their directions."""
    with np.errstate(invalid="ignore", over="ignore"):
        directions = arguments.directions.astype(np.float32)
        if arguments.segments:
            directions -= arguments.origins.astype(np.float32)
        directions /= np.maximum(np.linalg.norm(directions, axis=1, keepdims=True), 1e-30)
        return np.lexsort((morton_codes(directions), morton_codes(arguments.origins)))


def _lengthened(rays: RayPass) -> tuple[RayPass, np.ndarray]:
    """Scale short directions up by powers of two, which is exact. Returns the rays and the (n, 1) float64 factors.

    Tracers compute multiples of directions that are as long as the scene, which might overflow float32.
    """
    exponents = np.frexp(np.abs(rays.directions).max(1, initial=0.0, keepdims=True))[1]
    factors = np.ldexp(1.0, np.maximum(_MIN_EXPONENT - exponents, 0))
    return rays._replace(directions=(rays.directions * factors).astype(np.float32)), factors


@kernel
def _write_weights(ticket, rays, faces, corners, u, v):
    """Worker: write the weights of the second and third corner at each hit."""
    for i in items(ticket):
        if faces[i] >= 0:
            o, d = rays.origins[i], rays.directions[i]
            ray = ray_along(o[0], o[1], o[2], d[0], d[1], d[2], 0.0, np.inf)
            u[i], v[i] = single_weights(ray, corners, np.int64(faces[i]))


def weights(batch: HitBatch, threads: int) -> tuple[np.ndarray, np.ndarray]:
    """(u, v) of a batch's hits, each (n,) float32; 0 on a miss."""
    u, v = np.zeros(len(batch.places), np.float32), np.zeros(len(batch.places), np.float32)
    corners = batch.triangles.vertices.reshape(-1, 9)
    run(_write_weights, threads, new_ticket(len(u), 4096), batch.rays, batch.faces, corners, u, v)
    return u, v


# --- Scenes in a store ------------------------------------------------------------------------------------------------


MAX_MEMORY = 4 << 30
_CHUNKS_AT_ONCE = 256  # chunks whose triangles are numbered together
_NO_SLOTS = np.empty(0, np.int64)
BAND_FACTOR = 4  # bands pay off if a frame reads more than this multiple of the budget: neighbours share some chunks
RESERVED = 48 << 20  # bytes reserved for small allocations


class Paged:
    """A scene in a store, with its resident chunks: a `RenderSource` with a `FixedTree` and a `Memory`.

    Ray lists take turns with all other queries, since each of them loads and evicts chunks.

    Parameters
    ----------
    data : StoreData
    accelerator : Accelerator
        Its plan gives the tracer for the store's trees.
    settings : SourceSettings
        Its `max_memory` is a limit in bytes on the memory of the process at any time; None: 4 GiB.

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

    default_plan: ClassVar[str] = str(Plan(trace="chcrt"))
    looks: ClassVar[int] = 1
    gbuffer = RAYS
    geometry = None

    def __init__(self, data: StoreData, accelerator: Accelerator, settings: SourceSettings):
        plan, max_memory = accelerator.plan, settings.max_memory
        tracer, builds = plan.tracer, plan.cull or plan.optimise or plan.update or plan.build != Plan().build
        if builds or not isinstance(tracer, ChcRtTracer):
            raise InputError(
                f"plan {str(plan)!r}: {data.name} is in a store, whose trees are prebuilt; use {self.default_plan}"
            )
        limit = MAX_MEMORY if max_memory is None else byte_count(max_memory, "max_memory", 1)
        store = data.store
        self.scene, self.threads, self.max_memory = data, accelerator.threads, limit
        self._turn, self._evict_others = settings.turn, settings.evict_others
        self.store, self.residency = store, Residency(store, limit)
        self._start_paging: Paging | None = None  # the counts when the frame began
        self._joint_budget = 0  # bytes for rays that are traced together
        self._batch_sizes: dict[int, int] = {}  # size of an item -> number of items traced together
        self._bands, self._camera_mark = Bands(), 0  # the total of bytes read when the last camera rays were traced
        self._frame_reads = int(store.chunks.bytes.sum())  # bytes read in the last frame; initially the whole store
        parts = parts_of_chunks(store.top.nodes, store.chunks.root, self.residency.trees, self.residency, store)
        scheduled = ChcRtState(parts, tracer.options)
        self.accelerated: Accelerated = Accelerated(self._triangles(), None, scheduled)

    @property
    def fixed(self) -> "Paged":
        return self

    @property
    def memory(self) -> "Paged":
        return self

    @property
    def ray_lists(self) -> "Paged":
        return self

    def warm_up(self) -> None:
        precompile("scenes in a store")

    def begin(self, memory: FrameMemory) -> None:
        """Begin a frame. Rays that are traced together get up to half of the memory, and chunks the rest."""
        self._evict_others()
        self.residency.begin_question()  # before memory is measured
        release_freed()
        free = self.budget(memory)
        together, cells = min(free // 2, memory.passes), min(free // 8, memory.cells)
        self._joint_budget, self.accelerated.prepared.room = together, cells
        if self._start_paging is not None:
            self._frame_reads = self.residency.paging.bytes - self._start_paging.bytes
        self.residency.budget, self._start_paging = free - together - cells, self.residency.paging
        self.residency.trim()

    def release(self) -> None:
        """Evict all chunks, to leave their memory to other engines."""
        self.residency.budget = 0
        self.residency.trim()

    def together(self, size: int) -> int:
        n, previous = self.at_once(size), self._batch_sizes.get(size, 0)
        if 3 * n <= 4 * previous <= 5 * n:  # keep the previous number: the tracer's states are per batch
            return previous
        self._batch_sizes[size] = n
        return n

    def at_once(self, size: int) -> int:
        return max(1, self._joint_budget // 2 // max(size, 1))

    def budget(self, memory: FrameMemory) -> int:
        """Bytes left in a frame for chunks and for rays that are traced together.

        Raises
        ------
        InputError
            If they do not suffice for two chunks and a minimum of such rays.
        """
        free = self.max_memory - memory.fixed - RESERVED - (resident_memory() - self.residency.held)
        required = self.residency.min_budget() * 2
        if free < required:
            need = -(-(self.max_memory - free + required) >> 20)
            raise InputError(
                f"{self.scene.name}: {self.max_memory >> 20}M of memory is not enough for this many pixels or "
                f"points; give at least {need}M, or reduce their number"
            )
        return free

    @property
    def bounds(self) -> NDArray[np.float32]:
        return self.store.meta.box

    def paging(self) -> dict[str, int]:
        """Counts of chunks read and evicted in this frame."""
        now, before = self.residency.paging, self._start_paging
        assert before is not None
        return {name: a - b for name, a, b in zip(now._fields, now, before)}

    def bands(self, height: int) -> Iterator[slice]:
        budget = self.residency.budget
        for rows in self._bands.of_frame(height, self._frame_reads > BAND_FACTOR * budget):
            before = self.residency.paging.bytes
            yield rows
            self._bands.read(self._camera_mark - before, self.residency.paging.bytes - self._camera_mark, budget)

    def look(self, view: CameraView) -> Surfaces:
        """The surfaces visible to a camera."""
        camera, rows, progress = view.camera, view.rows, view.progress
        if camera.listed:
            passes, shape = (
                [camera_pass(cast(ExplicitRays, camera.view(self.scene.origin)), rows)],
                (rows.stop - rows.start, camera.width),
            )
            listed_hits = nearest_hits(self.accelerated.prepared, passes, shape, self.threads, progress)
            surfaces = next(self._surfaces_hit(passes, listed_hits, shape))
            self._camera_mark = self.residency.paging.bytes
            return surfaces
        rays = camera.rays(self.scene.origin)
        hits = camera_hits(self.accelerated.prepared, rays, self.threads, progress, rows)
        triangles, (face,) = self.hit_triangles([hits], self.threads)
        gbuffer = from_hits(face, hits.t, triangles, rays, self.threads, rows.start)
        self._camera_mark = self.residency.paging.bytes
        return Surfaces(gbuffer, triangles, hits.face, self.store.meta.box)

    def nearest(
        self, passes: Sequence[RayPass], shape: tuple[int, int], by: ChcRtState | None = None
    ) -> Iterator[Surfaces]:
        """The first surfaces hit by each of several passes of rays. Each chunk is read once for all passes.

        shape : (H, W) of the image
        by : another tracer over the same parts; None: the plan's tracer
        """
        return self._surfaces_hit(
            passes, nearest_hits(by or self.accelerated.prepared, passes, shape, self.threads), shape
        )

    def _surfaces_hit(
        self, passes: Sequence[RayPass], hits: Sequence[Hits], shape: tuple[int, int]
    ) -> Iterator[Surfaces]:
        """Yield the surfaces hit by passes, which must be the latest query."""
        triangles, faces = self.hit_triangles(hits, self.threads)
        for rays, hit, face in zip(passes, hits, faces):
            gbuffer = hit_surfaces(rays, face.reshape(-1), hit.t.reshape(-1), shape, triangles, self.threads)
            yield Surfaces(gbuffer, triangles, hit.face, self.store.meta.box)

    def trace_rays(self, rays: RayArguments, any_hit: bool, threads: int) -> TracedRays:
        arrays, out = rays.arrays(), hit_arrays(rays.n, any_hit)
        with self._turn:
            self.warm_up()
            for batch in self._batches(arrays, any_hit, rays.cull_faces, threads):
                at, hits = batch.places, batch.hits
                if any_hit:
                    out.blocked[at] = hits.face[0] >= 0
                else:
                    out.face[at], out.t[at] = hits.face[0], hits.t[0]
                    out.u[at], out.v[at] = weights(batch, threads)
        if any_hit:
            return TracedRays(out, None)
        return TracedRays(out, partial(self._triangles_hit, rays.copied(), threads))

    def all_hits(self, rays: RayArguments, max_hits: int | None, rule: int, threads: int) -> AllHits:
        with self._turn:
            self.warm_up()
            precompile("all hits in stores")
            return all_hits(self.store, self._unordered_batches(rays), max_hits, rule, threads)

    def count_hits(self, rays: RayArguments, rule: int, threads: int) -> NDArray[np.int64]:
        with self._turn:
            self.warm_up()
            precompile("all hits in stores")
            return count_hits(self.store, self._unordered_batches(rays), rule, threads)

    def bodies(self, time: float) -> Bodies:
        """The surfaces as they are drawn: open edges and faces drawn twice would need all of them in memory."""
        return Bodies(self.store.meta.box, None, lambda rays, threads: self.count_hits(rays, INSIDE, threads), time)

    def closest_points(self, points: NDArray[np.float32], time: float, threads: int) -> NoReturn:
        raise InputError(
            "closest points need a scene in memory; this one is in a store: load the file it was built from"
        )

    def _unordered_batches(self, rays: RayArguments) -> Iterator[LocalRays]:
        """Yield the rays in batches for which memory suffices. No chunk stays in memory."""
        arrays = rays.arrays()
        arrays.check()
        self.begin(FrameMemory(0, 0, 2 * rays.n * RAY_BYTES))
        size = max(self.together(RAY_BYTES), MIN_BATCH)
        self.release()
        for first in range(0, rays.n, size):
            yield local_rays(arrays.part(slice(first, first + size)), rays.cull_faces)

    def _triangles_hit(self, rays: RayArguments, threads: int) -> tuple[Triangles, NDArray[np.int64]]:
        """The triangles hit by rays, and the index of each ray's triangle among them, or -1.

        The rays are traced again, since a store has no triangles in memory.
        """
        faces, parts, n = np.full(rays.n, -1), [], 0
        with self._turn:
            for batch in self._batches(rays.arrays(), False, rays.cull_faces, threads):
                faces[batch.places] = np.where(batch.faces >= 0, batch.faces + n, -1)
                parts.append(batch.triangles)
                n += len(batch.triangles.vertices)
            self.release()  # such queries are rare
        return concatenate(parts or [self.accelerated.triangles]), faces.reshape(rays.shape)

    def _batches(self, rays: RayArrays, any_hit: bool, cull_faces: int, threads: int) -> Iterator[HitBatch]:
        rays.check()
        m = len(rays.origins)
        self.begin(FrameMemory(0, 0, 2 * m * RAY_BYTES))
        self.accelerated.begin()
        size = max(self.together(RAY_BYTES), MIN_BATCH)
        return trace_batches(self, rays, BatchSettings(any_hit, cull_faces, size, threads))

    def subpixels(self, view: CameraView, edge: NDArray[np.bool_]) -> Surfaces:
        rays, shape = subpixel_rays(view.camera.view(self.scene.origin), edge, self.threads)
        return next(self.nearest([rays], shape))

    def hit_triangles(self, hits: Sequence[Hits], threads: int) -> tuple[Triangles, list[np.ndarray]]:
        """Copies of the triangles that rays hit, each once, and for each of `hits` their (h, w) int32 indices, or -1.

        `hits` must be those of the latest query.
        """
        parts = np.zeros(len(self.store), np.bool_)
        for each in hits:
            parts[np.unique(each.part[each.part >= 0])] = True

        def mark(first: np.ndarray, marks: np.ndarray) -> None:
            for each in hits:
                mark_hits(each, first, marks, threads)

        faces, copies, n = [np.full(each.part.shape, -1, np.int32) for each in hits], list[TriangleCopies](), 0
        chunks, sizes = np.flatnonzero(parts), self.store.chunks.triangles
        for begin in range(0, len(chunks), _CHUNKS_AT_ONCE):
            group = chunks[begin : begin + _CHUNKS_AT_ONCE]
            first, numbers = slot_starts(group, sizes), np.zeros(int(sizes[group].sum()), np.int32)
            for k, slots in hit_slots(group, sizes, mark):
                numbers[first[k] + slots] = np.arange(n, n + len(slots), dtype=np.int32)
                copies.append(self.residency.triangles(k, slots))
                n += len(slots)
            for each, face in zip(hits, faces):
                number_hits(each, first, numbers, face, threads)
        return self._triangles(copies), faces

    def _triangles(self, copies: Sequence[TriangleCopies] = ()) -> Triangles:
        """Concatenate copied triangles. The result is never empty, since kernels may read the first entry."""
        none = TriangleCopies(
            _NO_SLOTS, np.zeros((1, 3, 3), np.float32), np.zeros((1, 3), np.float32), np.zeros(1, np.int32)
        )
        _, vertices, colour, ids = (np.concatenate(arrays) for arrays in zip(*(copies or [none])))
        return Triangles(vertices, self.scene.origin.copy(), ids, colour)


class SharedStore:
    """A store, of which each engine has its own chunks in memory: `SharedTrees`."""

    default_plan: ClassVar[str] = Paged.default_plan

    def __init__(self, data: SceneData):
        self._data = cast(StoreData, data)

    def source(self, accelerator: Accelerator, settings: SourceSettings) -> Paged:
        """The source of an engine. InputError if the plan needs all triangles, or the limit is out of range."""
        return Paged(self._data, accelerator, settings)

    def flat(self) -> SceneTrees:
        """Always raises InputError: the triangles are never all in memory."""
        raise self._data.refusal()

    def clear(self) -> None:
        """Nothing is shared."""
