"""The engine: answers all queries about a scene by one plan, and caches what later queries can reuse.

The kernels of a plan are compiled before its first query. `Visibility` holds the result for points and lights.
"""

import threading
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from functools import partial
from typing import TYPE_CHECKING, Any, NamedTuple, TypeAlias, cast

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..checks import as_array, byte_count, checked_instance, choice, whole_number
from ..errors import InputError
from ..kernels.parallel import thread_count
from ..kernels.toolchain import kernel_manifest as needs
from ..kernels.toolchain.compile_pool import KernelRequest
from ..progress import ProgressCallback, show_progress, split_progress
from ..query.gbuffer import GBuffer
from ..query.light_samples import light_samples
from ..query.query_bounds import place, reach_of
from ..query.ray_list import HitArrays, HitFilter, RayArguments, cull_value, rays_of, segments_between
from ..query.receivers import Receivers
from ..query.shadow_query import ShadowQuery, fraction_lit, shadow_queries
from ..scene.camera import Camera
from ..scene.instance_data import InstanceData
from ..scene.light_lists import without_interleave
from ..scene.lights import Light, QuadLight, check_lights
from ..scene.scene_data import MemoryData, SceneData
from ..scene.triangles import AllHits, Hit, HitFaces, Triangles
from ..trace.counters import new_counters
from ..trace.rays.all_hits import INSIDE, ON_SURFACE, SURFACES, TRIANGLES
from ..trace.transmission import TracedQuery, lit_fraction
from .accelerator import Accelerated, Accelerator, SceneTrees
from .auto.cost_model import GOOD, QUICK
from .auto.strategies import STRATEGIES, TreeForms, answer_query
from .auto_accelerator import CULLER, accelerator_of
from .frame_tracer import FrameMemory, FrameTracer, RenderSource, points_memory
from .in_memory_source import InMemory
from .instanced_source import Instanced, SharedInstances, traces_instances
from .method_registry import BUILDERS, CULLERS, UPDATERS
from .plan import Plan, parse_plan
from .precompilation import Job, fixed_job, precompile, small_scene, small_view
from .primary_visibility import AUTO, METHODS, precompiled_method, primary_visibility
from .scene_reading import data_of

if TYPE_CHECKING:
    from ..store.store_file import StoreData
    from .paged_source import Paged

# --- Visibility -------------------------------------------------------------------------------------------------------


class Visibility(NamedTuple):
    """Visibility of light samples from points.

    The leading shape (...) is that of the points for a single light, and (..., lights) for a list of lights.
    """

    bits: NDArray[np.uint64]  # (..., ceil(n / 64)) uint64: bit s = sample s occluded; 0 beyond the samples of a light
    fraction: NDArray[np.float32]  # (...) float32 in [0, 1]: mean over the samples of the light that arrives
    samples: NDArray[np.int64]  # int64, () or (lights,): number of samples of each light
    colour: NDArray[np.float32] | None = None  # (..., 3) float32: `fraction` of red, green and blue; None: all equal

    @property
    def seen(self) -> NDArray[np.bool_]:
        """(...) bool: whether any sample is visible. For a light with one sample, whether the light is visible."""
        return self.fraction > 0.0

    @property
    def seen_samples(self) -> NDArray[np.bool_]:
        """(..., n) bool: whether sample s is visible; False beyond the samples of a light. n is the largest count."""
        words = np.ascontiguousarray(self.bits).astype("<u8", copy=False)
        n = int(self.samples.max(initial=0))
        occluded = np.unpackbits(words.view(np.uint8), axis=-1, count=n, bitorder="little")
        visible: NDArray[np.bool_] = (occluded == 0) & (np.arange(n) < self.samples[..., None])
        return visible

    def reshaped(self, shape: tuple[int, ...], single: bool) -> "Visibility":
        """The same values with another leading shape; `single`: drop the axis of lights, which has length 1."""
        words = self.bits.shape[-1]
        lights = () if single else (len(self.samples),)
        samples = self.samples.reshape(()) if single else self.samples
        fraction = self.fraction.reshape((*shape, *lights))
        colour = None if self.colour is None else self.colour.reshape((*shape, *lights, 3))
        return Visibility(self.bits.reshape((*shape, *lights, words)), fraction, samples, colour)

    def __repr__(self) -> str:
        samples = "/".join(map(str, np.unique(self.samples)))
        mean = f", {self.fraction.mean():.3g} of the light arrives" if self.fraction.size else ""
        return f"Visibility({self.fraction.shape}, {samples} samples{mean}; bits, fraction, samples, seen)"


def visibility_of(answers: Sequence[TracedQuery]) -> Visibility:
    """The `Visibility` of n points, (n, lights), from the answer for each light, whose receivers are a single row."""
    words = max(each.bits.shape[-1] for each in answers)
    fraction = _stack_last([lit_fraction(each)[0] for each in answers])
    counts = np.array([each.spp for each in answers], np.int64)
    colour = None
    if any(each.light is not None and each.light.values.shape[2] > 1 for each in answers):
        colour = np.stack([_colour_of(each)[0] for each in answers], axis=-2)
    return Visibility(_stack_bits([each.bits for each in answers], words)[0], fraction, counts, colour)


def _colour_of(traced: TracedQuery) -> NDArray[np.float32]:
    fraction = fraction_lit(traced.bits, traced.spp)
    return np.repeat(fraction[..., None], 3, -1) if traced.light is None else traced.light.colour_of(fraction)


def _stack_last(arrays: Sequence[np.ndarray]) -> np.ndarray:
    return arrays[0][..., None] if len(arrays) == 1 else np.stack(arrays, axis=-1)


def _stack_bits(bits_per_light: Sequence[np.ndarray], words: int) -> np.ndarray:
    """(1, m, lights, words): the bits of all lights, padded to the same number of words."""
    if len(bits_per_light) == 1:
        return bits_per_light[0][:, :, None]
    bits = np.zeros((*bits_per_light[0].shape[:2], len(bits_per_light), words), np.uint64)
    for k, light_bits in enumerate(bits_per_light):
        bits[:, :, k, : light_bits.shape[-1]] = light_bits
    return bits


# --- Precompilation of a plan's kernels -------------------------------------------------------------------------------


def warm_up(plan: Plan, gbuffer: str) -> None:
    """Compile the kernels that find surfaces and trace shadows by a plan."""
    precompile(tracing_job, plan, gbuffer)
    if plan.trace == "cones":
        precompile(wide_lights_job)


def tracing_job(plan: Plan, gbuffer: str = "raster") -> Job:
    """The job of tracing shadows by a plan. It shares the kernel record of rendering by this plan."""

    def work() -> None:
        if plan.tracer.chooses:
            trace_all_strategies(False)
        trace_small(plan, small_view())

    return Job(record_name(plan, gbuffer, False), work, recorded(plan, gbuffer, False))


def wide_lights_job() -> Job:
    """The job of `cones` with lights too wide for a single apex."""

    def work() -> None:
        light = QuadLight(np.array([-1, 0.5, -1]), np.array([2, 0, 0]), np.array([0, 0, 2]))
        trace_small(Plan(trace="cones"), (Camera((0, 2, 3), (0, 0, 0), width=96, height=96), [light]), 16)

    return fixed_job("cones, wide lights", work)


def record_name(plan: Plan, gbuffer: str, counters: bool) -> str:
    """The name under which the kernels of rendering by a plan are recorded."""
    return f"{plan} ({gbuffer}{', counted' if counters else ''})"


def recorded(plan: Plan, gbuffer: str, counters: bool) -> Callable[[], set[KernelRequest] | None]:
    """A function that returns the recorded kernels of rendering by a plan, or None if there is no record.

    For a plan without a record, they are combined from the records of plans that use its methods.
    """

    def without_counters(p: Plan) -> set[KernelRequest]:
        return needs.kernels_of_job(record_name(p, gbuffer, False)) or set()

    def kernels() -> set[KernelRequest] | None:
        record = needs.kernels_of_job(record_name(plan, gbuffer, counters))
        if record is not None:
            return record
        tracing = needs.kernels_of_job(record_name(Plan(trace=plan.trace), gbuffer, counters))
        if tracing is None:
            return None
        base = without_counters(Plan(trace="single"))
        for methods in _added_methods(plan):
            extended = without_counters(Plan(trace="single", **methods))
            tracing = (tracing - (base - extended)) | (extended - base)
        return tracing

    return kernels


def _added_methods(plan: Plan) -> list[dict[str, Any]]:
    """The methods that a plan adds to the default one, as plan fields, grouped as their kernels are recorded."""
    fields = "cull", "build", "optimise", "update"
    added = {f: method for f in fields if (method := getattr(plan, f)) not in (None, getattr(Plan(), f))}
    parts: list[dict[str, Any]] = [{field: method} for field, method in added.items()]
    if plan.cull and plan.update:
        parts.append({"cull": "grid32", "update": plan.update})
    return parts


def trace_small(plan: Plan, view: tuple[Camera, list[Light]], spp: int = 1) -> None:
    """Trace the shadows of a view of the small scene by a plan."""
    accelerator, triangles, (camera, lights) = accelerator_of(plan, 2), small_scene().triangles(0.0, 2), view
    samples = [light_samples(light, spp) for light in lights]
    queries = shadow_queries(triangles, primary_visibility(triangles, camera, None, 2), lights, samples, 0, 2)
    if accelerator.ray_selector is None:  # all triangles: culling leaves too few to reach every kernel of a builder
        accelerator.build(triangles)
    accelerator.answer_all(
        accelerator.build(triangles, accelerator.cull(triangles, queries), accelerator.sample_rays(triangles, queries)),
        queries,
    )


def trace_all_strategies(counters: bool) -> None:
    """Cull for the lights of the small scene, and trace them by every strategy of `auto` in each kind of its trees."""
    triangles, (camera, lights) = small_scene().triangles(0.0, 2), small_view()
    queries = shadow_queries(
        triangles, primary_visibility(triangles, camera, None, 2), lights, [light_samples(s, 1) for s in lights]
    )
    CULLERS[CULLER].cull(triangles, queries, 2)
    for build in (BUILDERS[QUICK].build, UPDATERS["refit"].keep(BUILDERS[GOOD].build).update):
        forms = TreeForms(build(triangles.vertices, 2), 2)
        for name, strategy in STRATEGIES.items():
            for query in queries:
                if strategy.suits(query, forms.extent.box):
                    answer_query(name, forms, query, 2, new_counters() if counters else None)


# --- The engine -------------------------------------------------------------------------------------------------------


_MAX_OTHER_ENGINES = 8  # engines of other plans that an engine caches

MAX_HITS = (1 << 31) - 1
"""Largest value of `max_hits`, and more than a scene has faces."""

MAX_COORDINATE = 1e38
"""Points for `contains` must be closer to 0, so that float32 can represent them."""

MERGES = {"none": TRIANGLES, "surface": SURFACES}
"""Rules by which hits are counted."""

_Options: TypeAlias = tuple[Plan, int, int | None]
"""Plan, threads and memory limit."""

_State: TypeAlias = tuple[SceneData, Plan, int, int | None, str]
"""Scene data, plan, threads, memory limit and G-buffer method."""


class Engine:
    """Answers queries about one scene by one plan, and caches trees and measurements between them.

    Python threads may share an engine. Ray queries of scenes in memory run concurrently; all other queries hold `lock`
    while they run.

    Parameters
    ----------
    scene : Scene, PagedScene, or anything that `antumbra.load` takes
        A scene in memory or in a store, a path, or a mesh of another library.
    plan : str, Plan or None
        The methods, such as ``"bsah+single"``. None: ``"auto"``, or ``"bsah+chcrt"`` for a scene in a store, or
        ``"bsah+wide"`` for a scene of instances, which other plans flatten. Ray lists in memory always use a separate
        tree.
    threads : int or None
        None: all cores.
    max_memory : int or None
        For a scene in a store, the limit in bytes on the memory of the process at any time; None: the scene's own
        limit, or 4 GiB.
    gbuffer : "raster", "rays" or "auto"
        The method of `surfaces`; all give the same bits. "auto": rasterise; once a tree is cached, use whichever is
        faster. Stores, and cameras that are not perspective, always use rays.

    Raises
    ------
    InputError
        If a value is out of range, the plan is unknown, or the plan does not support stores.
    """

    def __init__(
        self,
        scene: Any,
        plan: str | Plan | None = None,
        threads: int | None = None,
        max_memory: int | None = None,
        *,
        gbuffer: str = AUTO,
    ):
        data = data_of(scene)
        choice(gbuffer, "gbuffer", METHODS)
        limit = getattr(scene, "max_memory", None) if max_memory is None else max_memory
        self._start(data, _trees_of(data), plan, threads, limit, gbuffer)

    def __getstate__(self) -> _State:
        """Pickle the settings; everything else is rebuilt."""
        return self.data, self.plan, self.threads, self.max_memory, self.source.gbuffer

    def __setstate__(self, state: _State) -> None:
        self._start(state[0], _trees_of(state[0]), *state[1:])

    def _start(
        self,
        data: SceneData,
        trees: SceneTrees | SharedInstances | None,
        plan: str | Plan | None,
        threads: int | None,
        max_memory: int | None,
        gbuffer: str,
    ) -> None:
        self.data, self.threads = data, thread_count(threads)
        self.plan = parse_plan(default_plan_of(data) if plan is None else plan)
        self.max_memory, self._trees, self.lock = max_memory, trees, threading.RLock()
        self.accelerator: Accelerator = accelerator_of(self.plan, self.threads)
        self.source: RenderSource = self._new_source(gbuffer)
        self._frame, self._n_faces = tuple(data.origin.tolist()), data.n_triangles
        self._others: dict[_Options, Engine] = {}  # least recently used first
        self._warm = False  # whether its kernels are compiled

    def _new_source(self, gbuffer: str) -> RenderSource:
        if self._trees is None:
            return _paged()(cast("StoreData", self.data), self.accelerator, self.max_memory)
        if self.max_memory is not None:
            raise InputError(f"max_memory is for scenes in a store, and {self.data.name} is in memory; leave it out")
        if isinstance(self._trees, SceneTrees):
            return InMemory(cast(MemoryData, self.data), self.accelerator, self._trees, gbuffer)
        data = cast(InstanceData, self.data)
        if traces_instances(self.plan):
            return Instanced(data, self.accelerator, self._trees)
        return InMemory(data.flattened(), self.accelerator, self._trees.flat(), gbuffer)

    def with_options(self, plan: str | Plan | None, threads: int | None, max_memory: int | None) -> "Engine":
        """An engine with another plan, thread count or memory limit, which shares this one's triangles and trees.

        None: as in this engine. For a store, only the latest engine keeps chunks in memory, since those of the others
        would count against the limit.
        """
        if plan is None and threads is None and max_memory is None and not self._others:
            return self
        current = self.plan, self.threads, self.max_memory
        requested = (
            self.plan if plan is None else parse_plan(plan),
            self.threads if threads is None else thread_count(threads),
            self.max_memory if max_memory is None else byte_count(max_memory, "max_memory", 1),
        )
        with self.lock:
            if requested == current:
                if self.source.in_store:
                    self._others.clear()
                return self
            engine = self._others.pop(requested, None)
            if self.source.in_store:
                self._others.clear()
                self.source.release()
            if engine is None:
                engine = Engine.__new__(Engine)
                engine._start(self.data, self._trees, *requested, AUTO)
            self._others[requested] = engine
            if len(self._others) > _MAX_OTHER_ENGINES:
                self._others.pop(next(iter(self._others)))
            return engine

    def occluded(
        self,
        origins: "ArrayLike",
        directions: "ArrayLike | None" = None,
        tmin: "ArrayLike" = 0.0,
        tmax: "ArrayLike" = np.inf,
        skip_face: "ArrayLike | None" = None,
        time: float = 0.0,
        *,
        targets: "ArrayLike | None" = None,
        cull_faces: str | None = None,
        threads: int | None = None,
    ) -> NDArray[np.bool_]:
        """(...) bool: whether a triangle blocks each ray; `antumbra.Scene.occluded` documents the parameters."""
        hits = HitFilter(tmin, tmax, skip_face, cull_faces)
        rays = rays_of(origins, directions, hits, self._frame, self._n_faces, targets)
        return self._hits(rays, True, time, threads).blocked.reshape(rays.shape)

    def closest_hit(
        self,
        origins: "ArrayLike",
        directions: "ArrayLike | None" = None,
        tmin: "ArrayLike" = 0.0,
        tmax: "ArrayLike" = np.inf,
        skip_face: "ArrayLike | None" = None,
        time: float = 0.0,
        *,
        cull_faces: str | None = None,
        threads: int | None = None,
    ) -> Hit:
        """The nearest hits of rays; `antumbra.Scene.closest_hit` documents the parameters."""
        hit_filter = HitFilter(tmin, tmax, skip_face, cull_faces)
        rays = rays_of(origins, directions, hit_filter, self._frame, self._n_faces)
        hits = self._hits(rays, False, time, threads)
        faces = HitFaces(*(array.reshape(rays.shape) for array in (hits.t, hits.face, hits.u, hits.v)))
        data = self.data
        return Hit.of_scene(faces, self._finder(rays, faces.face, self._moment(time)), lambda: data.object_of_face)

    def all_hits(
        self,
        origins: "ArrayLike",
        directions: "ArrayLike | None" = None,
        tmin: "ArrayLike" = 0.0,
        tmax: "ArrayLike" = np.inf,
        skip_face: "ArrayLike | None" = None,
        time: float = 0.0,
        *,
        targets: "ArrayLike | None" = None,
        max_hits: int | None = None,
        cull_faces: str | None = None,
        threads: int | None = None,
    ) -> AllHits:
        """All hits of rays; `antumbra.Scene.all_hits` documents the parameters."""
        if max_hits is not None:
            max_hits = whole_number(max_hits, "max_hits", 1, MAX_HITS)
        hits = HitFilter(tmin, tmax, skip_face, cull_faces)
        rays = rays_of(origins, directions, hits, self._frame, self._n_faces, targets)
        with self._ready_source(threads) as source:
            return source.all_hits(rays, max_hits, TRIANGLES, self._moment(time), threads)

    def count_hits(
        self,
        origins: "ArrayLike",
        directions: "ArrayLike | None" = None,
        tmin: "ArrayLike" = 0.0,
        tmax: "ArrayLike" = np.inf,
        skip_face: "ArrayLike | None" = None,
        time: float = 0.0,
        *,
        targets: "ArrayLike | None" = None,
        merge: str = "none",
        cull_faces: str | None = None,
        threads: int | None = None,
    ) -> NDArray[np.int64]:
        """(...) int64: the number of hits of each ray; `antumbra.Scene.count_hits` documents the parameters."""
        rule = MERGES[choice(merge, "merge", MERGES)]
        hits = HitFilter(tmin, tmax, skip_face, cull_faces)
        rays = rays_of(origins, directions, hits, self._frame, self._n_faces, targets)
        with self._ready_source(threads) as source:
            return source.count_hits(rays, rule, self._moment(time), threads).reshape(rays.shape)

    def segment_hits(
        self,
        begin: NDArray[np.float32],
        end: NDArray[np.float32],
        skip_face: NDArray[np.int64],
        time: float = 0.0,
        threads: int | None = None,
    ) -> AllHits:
        """All hits of n segments, with t from 0 to 1.

        begin, end : (n, 3) float32, in the frame of the scene's triangles
        skip_face : (n,) int, a face to ignore, or -1
        """
        with self._ready_source(threads) as source:
            return source.all_hits(
                segments_between(begin, end, skip_face), None, TRIANGLES, self._moment(time), threads
            )

    def contains(self, points: "ArrayLike", time: float = 0.0, *, threads: int | None = None) -> NDArray[np.bool_]:
        """(...) bool: whether points are inside; `antumbra.Scene.contains` documents the parameters."""
        array, up = as_array(points, "points"), np.eye(3)["xyz".index(self.data.up)]
        if array.ndim < 1 or array.shape[-1] != 3:
            raise InputError(f"points must have shape (..., 3), not {array.shape}")
        if not np.abs(array).max(initial=0.0) < MAX_COORDINATE:
            first = int(np.argmin((np.abs(array) < MAX_COORDINATE).reshape(-1, 3).all(1)))
            raise InputError(f"points are NaN, infinite or beyond float32 (point {first})")
        rays = rays_of(array, up, HitFilter(0.0, np.inf), self._frame, self._n_faces)
        with self._ready_source(threads) as source:
            counts = source.count_hits(rays, INSIDE, self._moment(time), threads)
        inside: NDArray[np.bool_] = (counts >= ON_SURFACE) | (counts % 2 == 1)
        return inside.reshape(rays.shape)

    @contextmanager
    def _ready_source(self, threads: int | None) -> Iterator[RenderSource]:
        """The source, ready for a query of rays by some threads; a store is locked meanwhile."""
        if not self.source.in_store:
            yield self.source
            return
        engine = self.with_options(None, threads, None)
        with engine.lock:
            engine.source.warm_up()
            yield engine.source

    def _finder(
        self, rays: RayArguments, face: np.ndarray, moment: float
    ) -> Callable[[], tuple[Triangles, np.ndarray]]:
        """A function that returns the triangles of hits: those in memory, or those found in a store by a new query."""
        if isinstance(self.source, Instanced):
            return partial(self.source.triangles_hit, rays, face.copy(), moment)
        if not self.source.in_store:
            hit = self.source.triangles_hit(rays, face, moment)
            return lambda: hit
        copy = rays.copied()

        def find() -> tuple[Triangles, np.ndarray]:
            with self.lock:
                return self.source.triangles_hit(copy, face, moment)

        return find

    def _hits(self, rays: RayArguments, any_hit: bool, time: float, threads: int | None) -> HitArrays:
        moment = self._moment(time)
        threads = self.threads if threads is None else thread_count(threads)
        with self._ready_source(threads) as source:
            return source.trace_rays(rays, any_hit, moment, threads)

    def _moment(self, time: float) -> float:
        return 0.0 if type(time) is float and time == 0.0 else self.data.clamped(time)

    def surfaces(self, camera: Camera, time: float = 0.0) -> GBuffer:
        """The G-buffer of a camera at a time in seconds: the visible surface at each pixel."""
        checked_instance(camera, Camera, "camera")
        with self.lock:
            self._warm_up()
            self.source.begin(FrameMemory(0, 0, 0))
            triangles, tree = self.source.moment(self._moment(time))
            if tree is None and (camera.listed or self.source.gbuffer == "rays"):
                tree = self.accelerator.prepare_all(triangles)
            surfaces = self.source.look(camera, triangles, tree)
            return surfaces.gbuffer._replace(face=surfaces.ids)

    def visibility(
        self,
        receivers: Receivers,
        lights: Light | Sequence[Light],
        *,
        spp: int = 16,
        sampler: str = "larcher-pillichshammer",
        cull_faces: str | None = None,
        time: float = 0.0,
        progress: ProgressCallback | bool | None = None,
    ) -> Visibility:
        """The visibility of light samples from n receivers: a `Visibility` of shape (n, lights).

        `antumbra.visibility` documents the parameters. `Receivers.on_surface` and `in_space` make receivers.
        """
        checked_instance(receivers, Receivers, "receivers")
        lights = [without_interleave(light) for light in check_lights(lights, self.data.up)]
        samples = [light_samples(light, spp, sampler) for light in lights]
        for light in lights:
            if light.domain == "hemisphere" and not receivers.normals.size and receivers.n:
                raise InputError(f"{type(light).__name__} needs surface normals; give the points' normals")
        with show_progress("tracing shadow rays", progress) as callback:
            answers = self.shadows(receivers, lights, samples, cull_value(cull_faces), time, progress=callback)
        return visibility_of(answers)

    def shadows(
        self,
        receivers: Receivers,
        lights: Sequence[Light],
        samples: Sequence[NDArray[np.float64]],
        facing: int = 0,
        time: float = 0.0,
        *,
        later: int = 0,
        whole: bool = False,
        progress: ProgressCallback | None = None,
    ) -> list[TracedQuery]:
        """The shadow query of each light, with its answer.

        Parameters
        ----------
        receivers : Receivers
        lights : sequence of lights
        samples : sequence of (16, n, 3) float64
            The sample sets of each light, from `query.light_samples.light_samples`.
        facing : int
            A value of CULL_FACES.
        time : float
            Seconds, clamped to 0 .. `duration`.
        later : int
            Estimated number of rays in further queries. The plan `auto` builds better trees for more rays.
        whole : bool
            Surfaces that let at least half of the light pass block none, and others block all, as for `occluded`.
        progress : function of (done, total), optional

        Raises
        ------
        InputError
            If points or lights are too far from the scene, or memory is too small.
        """
        with self.lock:
            accelerator, source = self.accelerator, self.source
            self._warm_up()
            if source.in_store:
                needs = [points_memory(receivers.n, *each) for each in zip(lights, samples)]
                source.begin(FrameMemory(*map(sum, zip(*needs))))
            accelerator.begin(receivers.n * sum(each.shape[1] for each in samples), later)
            triangles, accelerated = source.for_points(self._moment(time))
            queries = self._queries(triangles, receivers, lights, samples, facing)
            if accelerated is None:  # the tree depends on the queries
                accelerated = accelerator.build(
                    triangles, accelerator.cull(triangles, queries), accelerator.sample_rays(triangles, queries)
                )
                source.keep_for_points(accelerated)
            accelerated.begin()
            if whole and accelerated.cutouts is not None:
                accelerated = accelerated._replace(cutouts=accelerated.cutouts.as_holes())
            bits = accelerator.answer_all(accelerated, queries, None, split_progress(progress, len(queries)))
            if whole:
                return [TracedQuery(*each) for each in zip(queries, bits)]
            return [TracedQuery(q, b, accelerator.transmission(triangles, q, b)) for q, b in zip(queries, bits)]

    def queries(
        self,
        receivers: Receivers,
        lights: Sequence[Light],
        samples: Sequence[NDArray[np.float64]],
        facing: int = 0,
        time: float = 0.0,
    ) -> list[ShadowQuery]:
        """The queries of `shadows`, without their bits."""
        with self.lock:
            return self._queries(self.source.moment(self._moment(time))[0], receivers, lights, samples, facing)

    def frame_tracer(self) -> FrameTracer:
        """A tracer for the rays of one frame. Hold `lock` from the first call of its methods to the last."""
        return FrameTracer(self.source, self.accelerator)

    def accelerated(self, time: float = 0.0) -> Accelerated:
        """The triangles at a time and their tree by this plan, which must not depend on the query.

        Raises
        ------
        InputError
            If the scene is in a store.
        """
        if self._trees is None:
            raise cast("StoreData", self.data).refusal()
        trees = self._trees.flat() if isinstance(self._trees, SharedInstances) else self._trees
        return trees.of(self.accelerator, self._moment(time))

    def _queries(
        self,
        triangles: Triangles,
        receivers: Receivers,
        lights: Sequence[Light],
        samples: Sequence[NDArray[np.float64]],
        facing: int,
    ) -> list[ShadowQuery]:
        origins, sides, normals = receivers
        box = self.source.box(triangles)
        reach = reach_of(box, origins, self.threads) if origins.size else 1.0
        corners, no_faces = triangles.vertices.reshape(-1, 9), np.full(sides.shape, -1, np.int32)
        placed = [place(light, triangles.origin, box, reach) for light in lights]
        return [
            ShadowQuery(origins, no_faces, sides, normals, corners, light, sets, facing, no_faces)
            for light, sets in zip(placed, samples)
        ]

    def _warm_up(self) -> None:
        """Compile the kernels of this plan at its first query."""
        if not self._warm:
            warm_up(self.plan, precompiled_method(self.source.gbuffer))
            self.source.warm_up()
            self._warm = True


def default_plan_of(data: SceneData) -> str:
    """The plan of an engine if none is given."""
    if isinstance(data, InstanceData):
        return Instanced.default_plan
    return InMemory.default_plan if isinstance(data, MemoryData) else _paged().default_plan


def _trees_of(data: SceneData) -> SceneTrees | SharedInstances | None:
    if isinstance(data, InstanceData):
        return SharedInstances(data)
    return SceneTrees(data) if isinstance(data, MemoryData) else None


def _paged() -> "type[Paged]":
    from .paged_source import Paged  # imported late: scenes in memory start faster without it

    return Paged
