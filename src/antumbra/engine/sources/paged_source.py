"""Scenes in a store: chunks are read when rays reach them, and evicted to stay within a memory budget.

Images are traced in bands of rows, and ray lists in batches of coherent rays, so that each chunk is read once per band
or batch. For `antumbra explain`, `explained_tree` joins the part of a store's tree that segments can reach.

A flight over a large city needs more chunks than fit in memory. If all camera rays were traced before all shadow rays,
both would read every chunk. The chunks of a band fit in memory, so its shadow rays reuse those of its camera rays
[Mattausch et al. 2015, Sec. 5.4].
"""

from collections.abc import Iterator, Sequence
from typing import ClassVar, NamedTuple, cast

import numpy as np
from numpy.typing import NDArray

from ...base.checks import byte_count
from ...base.errors import InputError
from ...base.progress import ProgressCallback
from ...bvh.nodes import CHILDREN, EMPTY, MAX_DEPTH, Bvh, aligned_empty, bvh_leaf, bvh_link
from ...kernels.exact.filters import single_weights
from ...kernels.exact.predicate import ray_along
from ...kernels.jit import kernel
from ...kernels.parallel import items, new_ticket, run
from ...query.gbuffer import from_hits
from ...query.pixel_refinement import subpixel_rays
from ...query.query_bounds import morton_codes
from ...query.ray_list import RayArguments, RayArrays, TracedRays, changed_error, hit_arrays
from ...query.ray_passes import RayPass, camera_pass
from ...query.shadow_query import ShadowQuery, Surfaces, new_bits
from ...scene.camera import Camera, CameraRays, ExplicitRays
from ...scene.triangles import AllHits, Triangles, concatenate
from ...store.chunk_residency import Paging, Residency, TriangleCopies, hit_slots, slot_starts
from ...store.store_file import Store, StoreData
from ...store.store_format import Chunk
from ...store.system_resources import release_freed, resident_memory
from ...techniques.chcrt.chc_rt import ChcRtState, camera_hits, nearest_hits, ray_hits
from ...techniques.chcrt.nearest_hits import mark_hits, number_hits
from ...techniques.chcrt.occlusion_queries import Pairs, answer_queries
from ...techniques.chcrt.picture_ray_sets import SegmentRaySets, segments_of
from ...techniques.chcrt.tree_parts import parts_of_chunks
from ...trace.rays.local_rays import LocalRays, local_rays
from ...trace.rays.ray_hits import Nearest, hit_surfaces
from ...trace.rays.single_rays import leaf_depths
from ...trace.tree_list import Hits
from ..accelerator import Accelerated, Accelerator
from ..frame_tracer import FrameMemory
from ..plan import Plan
from ..precompilation import precompile
from .paged_hits import all_hits, count_hits

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


def trace_batches(
    paged: "Paged", arguments: RayArrays, any_hit: bool, cull_faces: int, max_rays: int
) -> Iterator[HitBatch]:
    """Trace the rays of a list, at most `max_rays` at a time."""
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
        hits = ray_hits(paged.accelerated.prepared, rays, spans, cull_faces, any_hit, paged.threads, targets)
        hits = hits._replace(t=hits.t * factors.T)
        if any_hit:
            yield HitBatch(places, rays, hits, paged.accelerated.triangles, hits.face[0])
        else:
            triangles, (faces,) = paged.hit_triangles([hits])
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
    """A scene in a store, with its resident chunks; `RenderSource` documents the methods.

    Parameters
    ----------
    data : StoreData
    accelerator : Accelerator
        Its plan gives the tracer for the store's trees.
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

    default_plan: ClassVar[str] = str(Plan(trace="chcrt"))
    in_store: ClassVar[bool] = True
    looks: ClassVar[int] = 1
    gbuffer = "rays"

    def __init__(self, data: StoreData, accelerator: Accelerator, max_memory: int | None = None):
        plan = accelerator.plan
        if plan.tracer.culling is None or plan.cull or plan.optimise or plan.update or plan.build != Plan().build:
            raise InputError(
                f"plan {str(plan)!r}: {data.name} is in a store, whose trees are prebuilt; use {self.default_plan}"
            )
        limit = MAX_MEMORY if max_memory is None else byte_count(max_memory, "max_memory", 1)
        store = data.store
        self.scene, self.threads, self.max_memory = data, accelerator.threads, limit
        self.store, self.residency = store, Residency(store, limit)
        self._start_paging: Paging | None = None  # the counts when the frame began
        self._joint_budget = 0  # bytes for rays that are traced together
        self._batch_sizes: dict[int, int] = {}  # size of an item -> number of items traced together
        self._bands, self._camera_mark = Bands(), 0  # the total of bytes read when the last camera rays were traced
        self._frame_reads = int(store.chunks.bytes.sum())  # bytes read in the last frame; initially the whole store
        parts = parts_of_chunks(store.top.nodes, store.chunks.root, self.residency.trees, self.residency, store)
        scheduled = ChcRtState(parts, plan.tracer.culling)
        self.accelerated: Accelerated = Accelerated(self._triangles(), None, scheduled)

    def warm_up(self) -> None:
        precompile("scenes in a store")

    def begin(self, memory: FrameMemory) -> None:
        """Begin a frame. Rays that are traced together get up to half of the memory, and chunks the rest."""
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

    def moment(self, time: float) -> tuple[Triangles, Accelerated]:
        return self.accelerated.triangles, self.accelerated

    for_points = moment

    def keep(self, accelerated: Accelerated) -> None:
        pass

    keep_for_points = keep

    def box(self, triangles: Triangles) -> np.ndarray:
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

    def look(
        self,
        camera: Camera,
        triangles: Triangles | None = None,
        tree: Accelerated | None = None,
        progress: ProgressCallback | None = None,
        rows: slice | None = None,
    ) -> Surfaces:
        """The surfaces visible to a camera; `triangles` and `tree` are not used."""
        if camera.listed:
            rows = rows or slice(0, camera.height)
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
        triangles, (face,) = self.hit_triangles([hits])
        gbuffer = from_hits(face, hits.t, triangles, rays, self.threads, rows.start if rows else 0)
        self._camera_mark = self.residency.paging.bytes
        return Surfaces(gbuffer, triangles, hits.face, self.store.meta.box)

    def nearest_in(self, tree: Accelerated) -> Nearest:
        return self.nearest

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
        triangles, faces = self.hit_triangles(hits)
        for rays, hit, face in zip(passes, hits, faces):
            gbuffer = hit_surfaces(rays, face.reshape(-1), hit.t.reshape(-1), shape, triangles, self.threads)
            yield Surfaces(gbuffer, triangles, hit.face, self.store.meta.box)

    def trace_rays(self, rays: RayArguments, any_hit: bool, time: float, threads: int | None = None) -> TracedRays:
        """The hits of rays. `threads` is not used; the engine's number of threads applies."""
        arrays, out = rays.arrays(), hit_arrays(rays.n, any_hit)
        for batch in self._batches(arrays, any_hit, rays.cull_faces):
            at, hits = batch.places, batch.hits
            if any_hit:
                out.blocked[at] = hits.face[0] >= 0
            else:
                out.face[at], out.t[at] = hits.face[0], hits.t[0]
                out.u[at], out.v[at] = weights(batch, self.threads)
        return TracedRays(out, None)

    def all_hits(
        self, rays: RayArguments, max_hits: int | None, rule: int, time: float, threads: int | None = None
    ) -> AllHits:
        """All hits of rays. `threads` is not used; the engine's number of threads applies."""
        precompile("all hits in stores")
        return all_hits(self.store, self._unordered_batches(rays), max_hits, rule, self.threads)

    def count_hits(self, rays: RayArguments, rule: int, time: float, threads: int | None = None) -> NDArray[np.int64]:
        """The number of hits of each ray. `threads` is not used; the engine's number of threads applies."""
        precompile("all hits in stores")
        return count_hits(self.store, self._unordered_batches(rays), rule, self.threads)

    def _unordered_batches(self, rays: RayArguments) -> Iterator[LocalRays]:
        """Yield the rays in batches for which memory suffices. No chunk stays in memory."""
        arrays = rays.arrays()
        arrays.check()
        self.begin(FrameMemory(0, 0, 2 * rays.n * RAY_BYTES))
        size = max(self.together(RAY_BYTES), MIN_BATCH)
        self.release()
        for first in range(0, rays.n, size):
            yield local_rays(arrays.part(slice(first, first + size)), rays.cull_faces)

    def triangles_hit(self, rays: RayArguments, face: np.ndarray, time: float) -> tuple[Triangles, np.ndarray]:
        """The triangles hit by rays, and the index of each ray's triangle among them, or -1.

        The rays are traced again, since a store has no triangles in memory.
        """
        faces, parts, n = np.full(rays.n, -1), [], 0
        for batch in self._batches(rays.arrays(), False, rays.cull_faces):
            faces[batch.places] = np.where(batch.faces >= 0, batch.faces + n, -1)
            parts.append(batch.triangles)
            n += len(batch.triangles.vertices)
        self.release()  # such queries are rare
        return concatenate(parts or [self.accelerated.triangles]), faces.reshape(face.shape)

    def _batches(self, rays: RayArrays, any_hit: bool, cull_faces: int) -> Iterator[HitBatch]:
        rays.check()
        m = len(rays.origins)
        self.begin(FrameMemory(0, 0, 2 * m * RAY_BYTES))
        self.accelerated.begin()
        return trace_batches(self, rays, any_hit, cull_faces, max(self.together(RAY_BYTES), MIN_BATCH))

    def subpixels(
        self, triangles: Triangles, view: CameraRays | ExplicitRays, edge: np.ndarray, tree: Accelerated | None = None
    ) -> Surfaces:
        """The surfaces of the sub-pixels of selected pixels, by rays; `triangles` and `tree` are not used."""
        rays, shape = subpixel_rays(view, edge, self.threads)
        return next(self.nearest([rays], shape))

    def hit_triangles(self, hits: Sequence[Hits]) -> tuple[Triangles, list[np.ndarray]]:
        """Copies of the triangles that rays hit, each once, and for each of `hits` their (h, w) int32 indices, or -1.

        `hits` must be those of the latest query.
        """
        parts = np.zeros(len(self.store), np.bool_)
        for each in hits:
            parts[np.unique(each.part[each.part >= 0])] = True

        def mark(first: np.ndarray, marks: np.ndarray) -> None:
            for each in hits:
                mark_hits(each, first, marks, self.threads)

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
                number_hits(each, first, numbers, face, self.threads)
        return self._triangles(copies), faces

    def _triangles(self, copies: Sequence[TriangleCopies] = ()) -> Triangles:
        """Concatenate copied triangles. The result is never empty, since kernels may read the first entry."""
        none = TriangleCopies(
            _NO_SLOTS, np.zeros((1, 3, 3), np.float32), np.zeros((1, 3), np.float32), np.zeros(1, np.int32)
        )
        _, vertices, colour, ids = (np.concatenate(arrays) for arrays in zip(*(copies or [none])))
        return Triangles(vertices, self.scene.origin.copy(), ids, colour)


# --- The tree of a store as a single `Bvh`, for `antumbra explain` ----------------------------------------------------


_TRIANGLE_BYTES = 140  # memory of a triangle while the tree is joined


def explained_tree(paged: Paged, queries: Sequence[ShadowQuery]) -> tuple[Bvh, np.ndarray]:
    """The tree over the chunks that segments may enter: (Bvh, index in the whole scene of each of its triangles).

    Other chunks become empty children, so each ray takes the same steps as through the whole tree.

    Raises
    ------
    InputError
        If the tree does not fit in memory.
    """
    store = paged.store
    reached = _reached_chunks(paged, queries)
    need = int(store.chunks.triangles[reached].sum()) * _TRIANGLE_BYTES + resident_memory() - paged.residency.held
    if need > paged.max_memory:
        raise InputError(
            f"{paged.scene.name}: the trees that these rays may enter take {need >> 20}M of memory; give at least as "
            "much, or a smaller view"
        )
    return joined_tree(store, reached)


def joined_tree(store: Store, numbers: np.ndarray) -> tuple[Bvh, np.ndarray]:
    """The tree over some chunks of a store: (Bvh, index in the whole scene of each of its triangles).

    Raises
    ------
    InputError
        If the tree is deeper than a stack of the tracers.
    """
    chunks = [store.chunk(int(k)) for k in numbers]
    top = Bvh(*store.top, np.arange(len(store), dtype=np.int32), np.empty((0, 9), np.float32))
    above = leaf_depths(top) * (len(store) > 1)  # a single chunk needs no top tree
    if any(above[k] + leaf_depths(chunk.bvh).max() > MAX_DEPTH for k, chunk in zip(numbers, chunks)):
        raise InputError(f"{store.meta.name}: its tree has more than {MAX_DEPTH} levels; steps cannot be counted")
    ids = np.unique(np.concatenate([chunk.bvh.prim_ids for chunk in chunks])) if chunks else np.empty(0, np.int32)
    return _join_trees(store.top.nodes, len(store), numbers, chunks, ids), ids


def _reached_chunks(paged: Paged, queries: Sequence[ShadowQuery]) -> np.ndarray:
    """The chunks whose boxes segments enter, whether or not they are blocked before."""
    scheduled, k = paged.accelerated.prepared, len(paged.store)
    reached = np.zeros(k, np.bool_)
    for query in queries:
        bits = new_bits(query)
        for step in segments_of(scheduled.parts, query):
            rays = SegmentRaySets(scheduled.parts, scheduled.options, step, bits, paged.threads)
            for s in range(rays.sets):
                screen = np.full(k, len(rays.tiles.spans) - 1, np.int32)  # the tile that covers the whole screen
                pairs = Pairs(screen, np.full(k, s, np.int32), np.arange(k, dtype=np.int32))
                reached |= answer_queries(rays.rays, scheduled.parts.heads, pairs, 0, paged.threads).counts > 0
    return np.flatnonzero(reached)


def _join_trees(top: np.ndarray, k: int, reached: np.ndarray, chunks: list[Chunk], ids: np.ndarray) -> Bvh:
    """Join the top tree of k chunks and the trees of those reached; `top`: see `store.store_file.TopTree`."""
    m = len(top) if k > 1 else 0  # a single chunk needs no top tree
    sizes = np.array([0, *(len(chunk.bvh.nodes) for chunk in chunks)])
    firsts = m + np.cumsum(sizes)
    nodes = aligned_empty((max(int(firsts[-1]), 1), 16), "f4")
    links, slots = nodes.view(np.int32)[:, CHILDREN], 0
    if not chunks:
        nodes[0], links[0] = 0.0, EMPTY
        nodes[0, 0:12:4] = nodes[0, 1:12:4] = np.inf
        nodes[0, 2:12:4] = nodes[0, 3:12:4] = -np.inf
        return Bvh(nodes[:1], nodes[:1].view(np.int32), np.empty(0, np.int32), np.empty((0, 9), np.float32))
    if m:
        root_of = np.full(k, EMPTY, np.int64)
        root_of[reached] = firsts[:-1]
        nodes[:m] = top
        leaf = (links[:m] < 0) & (links[:m] != EMPTY)
        links[:m][leaf] = root_of[bvh_leaf(links[:m][leaf]).first]
    for first, end, chunk in zip(firsts[:-1], firsts[1:], chunks):
        nodes[first:end] = chunk.bvh.nodes
        chunk_links = links[first:end]
        is_full, leaf = (chunk_links < 0) & (chunk_links != EMPTY), bvh_leaf(chunk_links)
        moved = bvh_link(leaf.first + slots, leaf.count)
        chunk_links[...] = np.where(is_full, moved, np.where(chunk_links >= 0, chunk_links + int(first), chunk_links))
        slots += len(chunk.bvh.prim_ids)
    prim_ids = np.searchsorted(ids, np.concatenate([chunk.bvh.prim_ids for chunk in chunks])).astype(np.int32)
    corners = np.concatenate([chunk.bvh.corners for chunk in chunks])
    return Bvh(nodes, nodes.view(np.int32), prim_ids, corners)
