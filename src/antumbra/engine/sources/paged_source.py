"""Scenes in a store: chunks are read when rays reach them, and evicted to stay within a memory budget.

Images are traced in bands of rows, and ray lists in batches of coherent rays, so that each chunk is read once per band
or batch.

A flight over a large city needs more chunks than fit in memory, that of the process or of a device. If all camera rays
were traced before all shadow rays, both would read every chunk. The chunks of a band fit in memory, so its shadow and
diffuse rays reuse those of its camera rays [Mattausch et al. 2015, Sec. 5.4].
"""

from collections.abc import Callable, Iterator, Sequence
from functools import cached_property, partial
from typing import Any, ClassVar, NamedTuple, NoReturn, cast

import numpy as np
from numpy.typing import NDArray

from ...base.checks import byte_count
from ...base.errors import InputError
from ...base.progress import ProgressCallback
from ...kernels.exact.filters import single_weights
from ...kernels.exact.predicate import ray_along
from ...kernels.jit import kernel
from ...kernels.parallel import items, new_ticket, run
from ...query.gbuffer import from_hits
from ...query.pixel_refinement import subpixel_rays
from ...query.query_bounds import morton_codes
from ...query.ray_list import HitArrays, RayArguments, RayArrays, TracedRays, changed_error, hit_arrays
from ...query.ray_passes import RayPass, camera_pass, rays_through
from ...query.shadow_query import Surfaces
from ...scene.camera import Camera, ExplicitRays
from ...scene.scene_data import SceneData
from ...scene.triangles import AllHits, Triangles, concatenate
from ...store.chunk_residency import Paging, RangeMemory, Residency, TriangleCopies, hit_slots, slot_starts
from ...store.store_data import StoreData
from ...store.store_directory import top_tree
from ...store.store_file import FaceRange, Store
from ...store.system_resources import default_limit, release_freed, resident_memory
from ...techniques.chcrt.chc_rt import ChcRtRanges, ChcRtState, camera_hits, nearest_hits, ray_hits
from ...techniques.chcrt.chcrt_tracer import ChcRtTracer
from ...techniques.chcrt.nearest_hits import mark_hits, number_hits
from ...techniques.chcrt.tree_parts import TreeParts, parts_of_chunks
from ...trace.alpha_cutouts import add_hits
from ...trace.rays.all_hits import INSIDE
from ...trace.rays.local_rays import local_pass, local_rays
from ...trace.rays.ray_hits import hit_surfaces
from ...trace.tree_list import Hits
from ..accelerator import Accelerated, Accelerator, SceneTrees
from ..device_tracers import device_tracer
from ..plan import Plan
from ..precompilation import precompile
from ..primary_visibility import RAYS
from .cutout_hits import CutoutHits
from .paged_cutouts import PagedCutouts, TracedHits
from .paged_hits import RayBatch, all_hits, count_hits
from .range_hits import FirstHits, NearestSoFar, first_hits, in_store, nearer, numbered, skipped_faces
from .source_protocols import Bodies, CameraView, FrameMemory, SourceSettings

# --- Bands of rows ----------------------------------------------------------------------------------------------------


_MIN_ROWS = 32  # the rows of a region: four rows of the sparsest grid of bounced light
_FIRST_ROWS = 64  # rows of the first band
_NEW_SHARE = 0.5  # share of memory that the new chunks of a band should fill
_SLACK = 0.1  # share of memory that may come twice in a band, or newly in a frame, without a change of the bands
_PAUSE_FRAMES = 16  # frames without bands after bands have not helped


class Bands:
    """Chooses the bands of each frame from what came to memory in earlier ones.

    A band fits in memory if few chunks come twice. Frames go down and up in turn, so that each begins with the chunks
    in memory.
    """

    def __init__(self) -> None:
        self._height, self._known = 0, list[slice]()  # of the last frame: its rows, and its bands, or halves of them
        self._rows, self._fit = _FIRST_ROWS, True
        self._banded, self._up, self._pause = True, True, 0

    def of_frame(self, height: int, exceeds: bool) -> Iterator[slice]:
        """Yield the rows of each band, from top to bottom or from bottom to top. The caller calls `traced` after each.

        exceeds : whether the scene exceeds memory; otherwise, there is a single band
        """
        last = self._known if height == self._height else []
        self._height, self._known = height, []
        self._pause -= 1
        if not exceeds or not self._banded or self._pause > 0:
            self._rows = height
            yield slice(0, height)
            self._banded = not self._fit
            return
        self._up, self._rows = not self._up, _FIRST_ROWS
        known = {(band.stop if self._up else band.start): band for band in last}
        edge, end = (height, 0) if self._up else (0, height)
        while edge != end:
            band = known.get(edge) or self._next(edge, height)
            self._rows = band.stop - band.start
            yield band
            self._known += [band] if self._fit else _halves(band)
            edge = band.start if self._up else band.stop

    def _next(self, edge: int, height: int) -> slice:
        """The band at an edge of the rows that are done."""
        if self._up:
            return slice(max(edge - self._rows, 0) // _MIN_ROWS * _MIN_ROWS, edge)
        return slice(edge, min(edge + self._rows, height))

    def traced(self, loaded: int, returned: int, budget: int) -> None:
        """Choose the rows of the next band.

        loaded, returned : bytes of the chunks that came to memory while the last band was traced, and came once more
        budget : limit in bytes on the chunks in memory
        """
        self._fit = returned <= _SLACK * budget
        if self._fit:
            self._rows = _regions(int(self._rows * min(2.0, _NEW_SHARE * budget / max(loaded, 1))))
        elif self._rows > _MIN_ROWS:
            self._rows = _regions(self._rows // 2)
        else:  # the chunks of even the smallest band do not fit in memory
            self._rows, self._pause = 1 << 30, _PAUSE_FRAMES

    def end_frame(self, loaded: int, free: int, budget: int) -> None:
        """End a frame. The next one needs no bands if there is memory left, or if few chunks were new in this one.

        loaded : bytes of the chunks that came to memory in this frame
        free : bytes of memory for chunks that are left
        """
        self._banded &= free < _SLACK * budget < loaded


def _halves(band: slice) -> list[slice]:
    middle = min(band.start + _regions((band.stop - band.start) // 2), band.stop)
    return [each for each in (slice(band.start, middle), slice(middle, band.stop)) if each.start < each.stop]


def _regions(rows: int) -> int:
    """Round down to the rows of whole regions; at least one region."""
    return max(rows // _MIN_ROWS, 1) * _MIN_ROWS


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
    blocked: NDArray[np.bool_]  # (n,)
    hits: Hits  # (1, n); for any-hit without cut-outs
    triangles: Triangles  # the triangles hit; empty for any-hit
    faces: NDArray[np.int32]  # (n,): index of each hit's triangle in `triangles`, or -1


class BatchSettings(NamedTuple):
    """How the rays of a list are traced."""

    any_hit: bool
    cull_faces: int  # a value of CULL_FACES
    max_rays: int  # traced at a time
    threads: int


def trace_batches(
    paged: "Paged", of: FaceRange, state: ChcRtState, arguments: RayArrays, settings: BatchSettings
) -> Iterator[HitBatch]:
    """Trace the rays of a list through a range of faces, batch by batch."""
    any_hit, cull_faces, max_rays, threads = settings
    order, cutouts = _coherent_order(arguments), paged.cutouts
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
        hits = ray_hits(state, rays, spans, cull_faces, any_hit, threads, targets)
        hits = hits._replace(t=hits.t * factors.T, part=in_store(hits.part, of))
        if any_hit:
            blocked = hits.face[0] >= 0
            if cutouts is not None:
                out = hit_arrays(0, False)._replace(blocked=blocked)
                add_hits(cutouts.tree, part, cull_faces, True, out, threads)
            yield HitBatch(places, rays, blocked, hits, paged.accelerated.triangles, hits.face[0])
            continue
        triangles, (faces,) = paged.hit_triangles([hits], threads)
        if cutouts is not None:
            found = TracedHits(hits.face[0], hits.t[0], faces[0], triangles)
            face, t, row, triangles = cutouts.show(local_rays(part, cull_faces), found, threads)
            hits, faces = hits._replace(face=face[None], t=t[None]), row[None]
        yield HitBatch(places, rays, hits.face[0] >= 0, hits, triangles, faces[0])


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


_CHUNKS_AT_ONCE = 256  # chunks whose triangles are numbered together
_NO_SLOTS = np.empty(0, np.int64)
RESERVED = 48 << 20  # bytes reserved for small allocations
DEVICE_CHUNKS = 8 << 30  # bytes of chunks on a device, at most


def _no_hits_of(n: int, any_hit: bool, store: Store) -> HitArrays:
    """`HitArrays` of n rays that hit nothing, for the faces of a store."""
    out = hit_arrays(n, any_hit)
    for array, value in zip(out, (False, -1, np.inf, 0.0, 0.0)):
        array[...] = value
    return out if any_hit else out._replace(face=np.full(n, -1, store.face_dtype))


class Paged:
    """A scene in a store, with its resident chunks: a `RenderSource` with a `FixedTree` and a `Memory`.

    Ray lists take turns with all other queries, since each of them loads and evicts chunks.

    Parameters
    ----------
    data : StoreData
    accelerator : Accelerator
        Its plan gives the tracer for the store's trees.
    settings : SourceSettings
        Its `max_memory` is a limit in bytes on the memory of the process at any time; None: `default_limit`.
    find_cutouts : function of (max_memory, threads)
        Returns the cut-outs; None: all faces are solid.

    Attributes
    ----------
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
    geometry = plan = None

    def __init__(
        self,
        data: StoreData,
        accelerator: Accelerator,
        settings: SourceSettings,
        find_cutouts: Callable[[int, int], PagedCutouts | None],
    ):
        plan, max_memory = accelerator.plan, settings.max_memory
        self._device = plan.device
        tracer, builds = plan.tracer, plan.cull or plan.optimise or plan.update or plan.build != Plan().build
        if builds or not isinstance(tracer, ChcRtTracer):
            raise InputError(
                f"plan {str(plan)!r}: {data.name} is in a store, whose trees are prebuilt; use {self.default_plan}"
            )
        self.limit = None if max_memory is None else byte_count(max_memory, "max_memory", 1)
        store = data.store
        self.scene, self.threads = data, accelerator.threads
        self._turn, self._evict_others = settings.turn, settings.evict_others
        self.store, self.residency = store, Residency(store, self.limit or default_limit())
        self._start_paging: Paging | None = None  # the counts when the frame began
        self._joint_budget = 0  # bytes for rays that are traced together
        self._frame_budget, self._rooms = 0, (0, 0)  # for chunks when the frame began; of `make_room`: staying, passing
        self._batch_sizes: dict[int, int] = {}  # size of an item -> number of items traced together
        self._bands = Bands()
        states = [ChcRtState(self._parts(each), tracer.options) for each in store.ranges]
        numbers = [each.numbers for each in store.ranges]
        scheduled = states[0] if store.ranges[0].is_all else ChcRtRanges(states, numbers)
        self._ranges = list(zip(store.ranges, states))
        self._scheduled, self._find_cutouts = scheduled, find_cutouts
        self._start_traffic: Any = None  # the counts of the device when the frame began

    @property
    def max_memory(self) -> int:
        """Limit in bytes on the memory of the process: what was set, or the default, which grows with the process."""
        return default_limit(self.residency.held) if self.limit is None else self.limit

    @cached_property
    def on_device(self) -> Any:
        """The chunks in the memory of a device: a `techniques.chcrt.device_residency.DeviceResidency`.

        None: the plan names no device. It is opened when the first frame begins.
        """
        return None if self._device is None else self._open_device(self._device)

    def _open_device(self, name: str) -> Any:
        from ...techniques.chcrt.device_parts import OnDeviceParts  # imported late: most engines use no device
        from ...techniques.chcrt.device_residency import DeviceResidency
        from ...trace.device.tree_list_tracer import TiledTracer

        store, host, device = self.store, self.residency, device_tracer(name).device
        budget = min(DEVICE_CHUNKS, device.room() * 3 // 4)
        if device.in_host_memory:
            budget = min(budget, self.max_memory // 8)
        there, tracer = DeviceResidency(device, host, host.tree, len(store), budget), TiledTracer(device)
        tracer.launches.evict = there.evict
        for each, state in self._ranges:
            memory = there if each.is_all else RangeMemory(there, each.chunks)
            state.on_device = OnDeviceParts(tracer, state.parts._replace(trees=there.trees[each.chunks], memory=memory))
        return there

    @cached_property
    def cutouts(self) -> PagedCutouts | None:
        """The cut-outs, all of which are in memory from now on; None: all faces are solid."""
        return self._find_cutouts(self.max_memory, self.threads)

    @cached_property
    def accelerated(self) -> Accelerated:
        """The input of the plan's tracer; it holds no triangles but the cut-outs."""
        tree = None if self.cutouts is None else self.cutouts.tree
        return Accelerated(self._triangles(), None, self._scheduled, tree)

    def _parts(self, each: FaceRange) -> TreeParts:
        """The chunks of a range."""
        store, residency, chunks = self.store, self.residency, each.chunks
        if each.is_all:
            return parts_of_chunks(store.top.nodes, store.chunks.root, residency.trees, residency, store)
        top = top_tree(store.chunks.box[chunks], self.threads).nodes
        memory = RangeMemory(residency, chunks)
        return parts_of_chunks(top, store.chunks.root[chunks], residency.trees[chunks], memory, store)

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
        if self.scene.has_cutouts:
            precompile("cut-outs")

    def begin(self, memory: FrameMemory) -> None:
        """Begin a frame. Rays that are traced together get up to half of the memory, and chunks the rest."""
        self._evict_others()
        self.residency.begin_question()  # before memory is measured
        release_freed()
        prepared = self.accelerated.prepared  # the cut-outs are read before memory is measured
        if self.on_device is not None:
            self._start_traffic = self.on_device.traffic
            self.on_device.trim()
        free = self._budget_with_looks(memory)
        together, cells = min(free // 2, memory.passes), min(free // 8, memory.cells)
        self._joint_budget, prepared.room = together, cells
        self.residency.budget, self._start_paging = free - together - cells, self.residency.paging
        self._frame_budget, self._rooms = self.residency.budget, (0, 0)
        self.residency.trim()

    def release(self) -> None:
        """Evict all chunks, to leave their memory to other engines."""
        self.residency.budget = 0
        self.residency.trim()

    def left(self) -> int:
        with self._turn:
            self.release()
        release_freed()
        return max(self.max_memory - RESERVED - 2 * self.residency.min_budget() - resident_memory(), 0)

    def has_room(self, size: int) -> bool:
        return size <= self.residency.budget // 2

    def make_room(self, size: int, what: str, stays: bool = False) -> None:
        kept, passing = self._rooms
        rooms = (kept + size, passing) if stays else (kept, size)
        left = self._frame_budget - sum(rooms)
        if left < (required := self.residency.min_budget()):
            need = -(-(self.max_memory + required - left) >> 20)
            raise InputError(
                f"{self.scene.name}: {self.max_memory >> 20}M of memory is not enough for {what}, or give {need}M"
            )
        self._rooms, self.residency.budget = rooms, left
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
        required = self.residency.min_budget() * 2
        if (free := self._free(memory)) < required:
            release_freed()
            free = self._free(memory)
        if free < required:
            need = -(-(self.max_memory - free + required) >> 20)
            raise InputError(
                f"{self.scene.name}: {self.max_memory >> 20}M of memory is not enough for this many pixels or "
                f"points; give at least {need}M, or reduce their number"
            )
        return free

    def _free(self, memory: FrameMemory) -> int:
        there = self.on_device
        coming = 0 if there is None or not there.device.in_host_memory else max(there.budget - there.used, 0)
        return self.max_memory - memory.fixed - RESERVED - coming - (resident_memory() - self.residency.held)

    def _budget_with_looks(self, memory: FrameMemory) -> int:
        """`budget`, once textures of earlier frames are released if they leave too little."""
        try:
            return self.budget(memory)
        except InputError:
            if (looks := self.scene.stored_looks) is None:
                raise
            looks.forget()
            release_freed()
            return self.budget(memory)

    @property
    def bounds(self) -> NDArray[np.float32]:
        return self.scene.box

    def paging(self) -> dict[str, int]:
        """Counts of chunks read and evicted in this frame; of those on a device, by ``device_`` and their names."""
        now, before = self.residency.paging, self._start_paging
        assert before is not None
        counts = {name: a - b for name, a, b in zip(now._fields, now, before)}
        if self.on_device is not None:
            there, begun = self.on_device.traffic, self._start_traffic
            counts |= {f"device_{name}": a - b for name, a, b in zip(there._fields, there, begun)}
        return counts

    def bands(self, height: int) -> Iterator[slice]:
        cache = self.residency if self.on_device is None else self.on_device
        begun = cache.loaded
        for rows in self._bands.of_frame(height, self.residency.size > cache.budget):
            self._begin_band(rows)
            cache.begin_band()
            before = cache.loaded
            yield rows
            self._bands.traced(cache.loaded - before, cache.returned, cache.budget)
        self._begin_band(None)
        self._bands.end_frame(cache.loaded - begun, cache.budget - cache.used, cache.budget)

    def _begin_band(self, rows: slice | None) -> None:
        for _, state in self._ranges:
            state.begin_band(rows)

    def look(self, view: CameraView) -> Surfaces:
        """The surfaces visible to a camera."""
        camera, rows, progress = view.camera, view.rows, view.progress
        if camera.listed:
            passes = [camera_pass(cast(ExplicitRays, camera.view(self.scene.origin)), rows)]
            shape = rows.stop - rows.start, camera.width
            return next(self._surfaces_hit(passes, shape, progress))._replace(device=self._seen_on)
        return self.see(camera, rows, progress)

    def see(
        self, camera: Camera, rows: slice, progress: ProgressCallback | None = None, only_solid: bool = False
    ) -> Surfaces:
        """The surfaces visible in some rows of a perspective camera; `only_solid`: without cut-outs."""
        rays, signed = camera.rays(self.scene.origin), len(self._ranges) > 1
        trace = lambda _, state: [camera_hits(state, rays, self.threads, progress, rows, signed)]
        triangles, (hits,) = self._first_hits(trace, self.threads)
        if self.cutouts is not None and not only_solid:
            of_band = np.zeros((camera.height, camera.width), np.bool_)
            of_band[rows] = True
            triangles, hits = self._shown(rays_through(rays, of_band, self.threads), hits, triangles)
        gbuffer = from_hits(hits.triangle, hits.t, triangles, rays, self.threads, rows.start)
        return Surfaces(gbuffer, triangles, hits.face, self.scene.box, device=self._seen_on)

    def nearest(
        self, passes: Sequence[RayPass], shape: tuple[int, int], by: ChcRtState | None = None
    ) -> Iterator[Surfaces]:
        """The first surfaces hit by each of several passes of rays. Each chunk is read once for all passes.

        shape : (H, W) of the image
        by : another tracer over the same parts; None: the plan's tracer
        """
        return self._surfaces_hit(passes, shape, by=by)

    def _surfaces_hit(
        self,
        passes: Sequence[RayPass],
        shape: tuple[int, int],
        progress: ProgressCallback | None = None,
        by: ChcRtState | None = None,
    ) -> Iterator[Surfaces]:
        """Yield the surfaces hit by passes, as `nearest`."""

        def trace(each: FaceRange, state: ChcRtState) -> list[Hits]:
            of_range = [rays._replace(skip=each.numbers(rays.skip)) for rays in passes]
            return nearest_hits(by or state, of_range, shape, self.threads, progress)

        triangles, hits = self._first_hits(trace, self.threads)
        for rays, hit in zip(passes, hits):
            shown = triangles
            if self.cutouts is not None:
                shown, hit = self._shown(rays, hit, triangles)
            gbuffer = hit_surfaces(rays, hit.triangle.reshape(-1), hit.t.reshape(-1), shape, shown, self.threads)
            yield Surfaces(gbuffer, shown, hit.face, self.scene.box)

    def _shown(self, rays: RayPass, hits: FirstHits, triangles: Triangles) -> tuple[Triangles, FirstHits]:
        """The triangles and the hits of a pass, with cut-outs where they are nearer."""
        assert self.cutouts is not None
        shape = hits.face.shape
        flat = TracedHits(hits.face.reshape(-1), hits.t.reshape(-1), hits.triangle.reshape(-1), triangles)
        found = self.cutouts.show(local_pass(rays), flat, self.threads)
        face, t, row = found.face.reshape(shape), found.t.reshape(shape), found.row.reshape(shape)
        return found.triangles, hits._replace(face=face, t=t, triangle=row)

    def _first_hits(
        self, trace: Callable[[FaceRange, ChcRtState], Sequence[Hits]], threads: int
    ) -> tuple[Triangles, list[FirstHits]]:
        """The triangles that several sets of rays hit first, and their hits.

        trace : returns the hits of each set in a range, with their signed t if there are several ranges
        """
        found, all_triangles, n = list[FirstHits](), list[Triangles](), 0
        for each, state in self._ranges:
            hits = [hit._replace(part=in_store(hit.part, each)) for hit in trace(each, state)]
            triangles, indices = self.hit_triangles(hits, threads)
            of_range = [first_hits(hit, index, n, each) for hit, index in zip(hits, indices)]
            found = [nearer(*pair) for pair in zip(found, of_range)] if found else of_range
            all_triangles.append(triangles._replace(face_id=each.faces(triangles.face_id)))
            n += len(triangles.vertices)
        return concatenate(all_triangles), found

    def trace_rays(self, rays: RayArguments, any_hit: bool, threads: int) -> TracedRays:
        out = _no_hits_of(rays.n, any_hit, self.store)
        with self._turn:
            self.warm_up()
            nearest = NearestSoFar(rays.n, len(self._ranges))
            for of, batch in self._batches(rays, any_hit, threads):
                at, hits = batch.places, batch.hits
                if any_hit:
                    out.blocked[at] |= batch.blocked
                    continue
                chosen = nearest.replaces(at, hits)
                at, (u, v) = at[chosen], weights(batch, threads)
                out.face[at], out.t[at] = of.faces(hits.face[0])[chosen], hits.t[0][chosen]
                out.u[at], out.v[at] = u[chosen], v[chosen]
        if any_hit:
            return TracedRays(out, None)
        return TracedRays(out, partial(self._triangles_hit, rays.copied(), threads))

    def all_hits(self, rays: RayArguments, max_hits: int | None, rule: int, threads: int) -> AllHits:
        with self._turn:
            self.warm_up()
            precompile("all hits in stores")
            return all_hits(self.store, self._unordered_batches(rays), max_hits, rule, threads, self._cutout_hits)

    def count_hits(self, rays: RayArguments, rule: int, threads: int) -> NDArray[np.int64]:
        with self._turn:
            self.warm_up()
            precompile("all hits in stores")
            return count_hits(self.store, self._unordered_batches(rays), rule, threads, self._cutout_hits)

    @property
    def _cutout_hits(self) -> CutoutHits | None:
        return None if self.cutouts is None else self.cutouts.hits

    def bodies(self, time: float) -> Bodies:
        """The surfaces as they are drawn: open edges and faces drawn twice would need all of them in memory."""
        return Bodies(self.scene.box, None, lambda rays, threads: self.count_hits(rays, INSIDE, threads), time)

    def closest_points(self, points: NDArray[np.float32], time: float, threads: int) -> NoReturn:
        raise InputError(
            "closest points need a scene in memory; this one is in a store: load the file it was built from"
        )

    def _unordered_batches(self, rays: RayArguments) -> Iterator[RayBatch]:
        """Yield the rays in batches for which memory suffices. No chunk stays in memory."""
        arrays, skip = rays._replace(skip=-1.0).arrays(), skipped_faces(rays)
        arrays.check()
        self.begin(FrameMemory(0, 0, 2 * rays.n * RAY_BYTES))
        size = max(self.together(RAY_BYTES), MIN_BATCH)
        self.release()
        for first in range(0, rays.n, size):
            part = slice(first, first + size)
            yield RayBatch(local_rays(arrays.part(part), rays.cull_faces), skip[part])

    def _triangles_hit(self, rays: RayArguments, threads: int) -> tuple[Triangles, NDArray[np.int64]]:
        """The triangles hit by rays, and the index of each ray's triangle among them, or -1.

        The rays are traced again, since a store has no triangles in memory.
        """
        faces, parts, n = np.full(rays.n, -1), [], 0
        with self._turn:
            nearest = NearestSoFar(rays.n, len(self._ranges))
            for of, batch in self._batches(rays, False, threads):
                chosen = nearest.replaces(batch.places, batch.hits)
                index = np.where(batch.faces >= 0, batch.faces + n, -1)
                faces[batch.places[chosen]] = index[chosen]
                parts.append(batch.triangles._replace(face_id=of.faces(batch.triangles.face_id)))
                n += len(batch.triangles.vertices)
            self.release()  # such queries are rare
        return concatenate(parts or [self.accelerated.triangles]), faces.reshape(rays.shape)

    def _batches(self, rays: RayArguments, any_hit: bool, threads: int) -> Iterator[tuple[FaceRange, HitBatch]]:
        """Trace the rays through all ranges, batch by batch."""
        for of, state in self._ranges:
            arrays = numbered(rays, of).arrays()
            arrays.check()
            self.begin(FrameMemory(0, 0, 2 * rays.n * RAY_BYTES))
            state.begin()
            settings = BatchSettings(any_hit, rays.cull_faces, max(self.together(RAY_BYTES), MIN_BATCH), threads)
            for batch in trace_batches(self, of, state, arrays, settings):
                yield of, batch

    def subpixels(self, view: CameraView, edge: NDArray[np.bool_]) -> Surfaces:
        rays, shape = subpixel_rays(view.camera.view(self.scene.origin), edge, self.threads)
        return next(self.nearest([rays], shape))

    def see_on_cpu(self) -> bool:
        seeing = [state for _, state in self._ranges if state.sees_on_device]
        for state in seeing:
            state.see_here()
        return bool(seeing)

    @property
    def _seen_on(self) -> str | None:
        """The device that finds nearest hits; None: the CPU finds them, at least in some ranges."""
        return self._device if all(state.sees_on_device for _, state in self._ranges) else None

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
    """A store, of which each engine has its own chunks in memory, but the same cut-outs: `SharedTrees`."""

    default_plan: ClassVar[str] = Paged.default_plan

    def __init__(self, data: SceneData):
        self._data = cast(StoreData, data)
        self._cutouts: PagedCutouts | None = None

    def source(self, accelerator: Accelerator, settings: SourceSettings) -> Paged:
        """The source of an engine. InputError if the plan needs all triangles, or the limit is out of range."""
        return Paged(self._data, accelerator, settings, self._find_cutouts)

    def _find_cutouts(self, max_memory: int, threads: int) -> PagedCutouts | None:
        """The cut-outs, which are read once. InputError if they do not fit in `max_memory` bytes."""
        data = self._data
        if self._cutouts is None and data.has_cutouts:
            if (need := data.cutout_bytes + RESERVED) > max_memory:
                raise InputError(
                    f"{data.name}: {max_memory >> 20}M of memory is not enough for the faces that let light pass, "
                    f"which take {need >> 20}M; give at least twice as much, or build it with ?cutouts=off"
                )
            stored = data.stored_cutouts
            if stored is not None and len(stored.cutouts.faces):
                self._cutouts = PagedCutouts(stored, data.origin, threads)
        return self._cutouts

    def flat(self) -> SceneTrees:
        """Always raises InputError: the triangles are never all in memory."""
        raise self._data.refusal()

    def clear(self) -> None:
        self._cutouts = None
