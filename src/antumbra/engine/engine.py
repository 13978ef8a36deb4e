"""The engine: the one door to all questions about a scene, and everything cached between them.

The kernels of a plan are compiled before its first question. `Visibility` is the answer for points and lights.
"""

import threading
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np

from ..checks import byte_count, choice, instance
from ..errors import InputError
from ..kernels.parallel import thread_count
from ..kernels.toolchain import kernel_manifest as needs
from ..kernels.toolchain.compile_pool import KernelRequest
from ..progress import show_progress, split_progress
from ..query.gbuffer import GBuffer
from ..query.light_samples import light_samples
from ..query.query_bounds import place, reach_of
from ..query.ray_list import HitArrays, RayArguments, cull_value, rays_of
from ..query.receivers import Receivers
from ..query.shadow_query import ShadowQuery, fraction_lit, shadow_queries
from ..scene.camera import Camera
from ..scene.light_lists import without_interleave
from ..scene.lights import Light, QuadLight, check_lights
from ..scene.scene_data import MemoryData, SceneData
from ..scene.triangles import Hit, HitFaces, Triangles
from ..trace.counters import new_counters
from .accelerator import Accelerated, Accelerator, SceneTrees, accelerator_of
from .auto.cost_model import GOOD, QUICK
from .auto.strategies import STRATEGIES, TreeForms, answer_query
from .frame_tracer import FrameMemory, FrameTracer, Progress, RenderSource, points_memory
from .in_memory_source import InMemory
from .method_registry import BUILDERS, UPDATERS
from .plan import Plan, parse_plan
from .precompilation import Job, fixed_job, precompile, small_scene, small_view
from .primary_visibility import AUTO, METHODS, compiled_for, primary_visibility
from .scene_reading import data_of

# --- Which samples of lights points see -------------------------------------------------------------------------------


class Visibility(NamedTuple):
    """What points see of a light, or of several; (...) is the points' leading shape, and (..., lights) for several."""

    bits: np.ndarray  # (..., ceil(n / 64)) uint64: bit s = sample s occluded; 0 beyond the samples of a light
    fraction: np.ndarray  # (...) float32 in [0, 1]: share of the samples that are not occluded
    samples: np.ndarray  # int64, () or (lights,): number of samples of each light

    @property
    def seen(self) -> np.ndarray:
        """(...) bool: whether the point sees any sample. For a light of one sample, whether it sees the light."""
        return self.fraction > 0.0

    @property
    def seen_samples(self) -> np.ndarray:
        """(..., n) bool: whether the point sees sample s. n: the most samples of a light; False beyond its own."""
        words = np.ascontiguousarray(self.bits).astype("<u8", copy=False)
        n = int(self.samples.max(initial=0))
        occluded = np.unpackbits(words.view(np.uint8), axis=-1, count=n, bitorder="little")
        return (occluded == 0) & (np.arange(n) < self.samples[..., None])

    def reshaped(self, shape: tuple[int, ...], alone: bool) -> "Visibility":
        """The same for points of another leading shape; `alone`: of the only light, without the axis of lights."""
        words = self.bits.shape[-1]
        lights = () if alone else (len(self.samples),)
        samples = self.samples.reshape(()) if alone else self.samples
        return Visibility(
            self.bits.reshape((*shape, *lights, words)), self.fraction.reshape((*shape, *lights)), samples
        )

    def __repr__(self) -> str:
        samples = "/".join(map(str, np.unique(self.samples)))
        mean = f", {self.fraction.mean():.3g} of the samples seen" if self.fraction.size else ""
        return f"Visibility({self.fraction.shape}, {samples} samples{mean}; bits, fraction, samples, seen)"


def visibility_of(bits: Sequence[np.ndarray], counts: Sequence[int]) -> Visibility:
    """The `Visibility` of a list of n points, (n, lights), from the bits of each light, (1, n, words) uint64."""
    words = max(each.shape[-1] for each in bits)
    fraction = _last_axis([fraction_lit(each, n)[0] for each, n in zip(bits, counts)])
    return Visibility(_side_by_side(bits, words)[0], fraction, np.array(counts, np.int64))


def _last_axis(arrays: Sequence[np.ndarray]) -> np.ndarray:
    return arrays[0][..., None] if len(arrays) == 1 else np.stack(arrays, axis=-1)


def _side_by_side(found: Sequence[np.ndarray], words: int) -> np.ndarray:
    """The bits of the lights, (1, m, lights, words)."""
    if len(found) == 1:
        return found[0][:, :, None]
    bits = np.zeros((*found[0].shape[:2], len(found), words), np.uint64)
    for k, of_light in enumerate(found):
        bits[:, :, k, : of_light.shape[-1]] = of_light
    return bits


# --- The kernels of plans, which are compiled before the first question is answered -----------------------------------


def warm_up(plan: Plan, gbuffer: str) -> None:
    """Compile the kernels of surfaces and shadows by a plan."""
    precompile(tracing_job, plan, gbuffer)
    if plan.trace == "cones":
        precompile(wide_lights_job)


def tracing_job(plan: Plan, gbuffer: str = "raster") -> Job:
    """The job of shadows by a plan, which has the record of pictures by this plan."""

    def work():
        if plan.tracer.chooses:
            trace_all_ways(False)
        trace_small(plan, small_view())

    return Job(record_of(plan, gbuffer, False), work, recorded(plan, gbuffer, False))


def wide_lights_job() -> Job:
    """The job of `cones` with lights too wide for one apex."""

    def work():
        light = QuadLight(np.array([-1, 0.5, -1]), np.array([2, 0, 0]), np.array([0, 0, 2]))
        trace_small(Plan(trace="cones"), (Camera((0, 2, 3), (0, 0, 0), width=96, height=96), [light]), 16)

    return fixed_job("cones, wide lights", work)


def record_of(plan: Plan, gbuffer: str, counters: bool) -> str:
    """The name under which the kernels of pictures by a plan are recorded."""
    return f"{plan} ({gbuffer}{', counted' if counters else ''})"


def recorded(plan: Plan, gbuffer: str, counters: bool) -> Callable[[], set[KernelRequest] | None]:
    """A function that gives the recorded kernels of pictures by a plan; None: there is no record.

    A plan without a record gets the kernels of recorded plans with its methods.
    """
    plain = lambda p: needs.kernels_of_job(record_of(p, gbuffer, False)) or set()

    def kernels():
        found = needs.kernels_of_job(record_of(plan, gbuffer, counters))
        if found is not None:
            return found
        tracing = needs.kernels_of_job(record_of(Plan(trace=plan.trace), gbuffer, counters))
        if tracing is None:
            return None
        usual = plain(Plan(trace="single"))
        for methods in _parts(plan):
            with_it = plain(Plan(trace="single", **methods))
            tracing = (tracing - (usual - with_it)) | (with_it - usual)
        return tracing

    return kernels


def _parts(plan: Plan) -> list[dict[str, str]]:
    """Methods whose kernels are recorded together, as fields of a plan, for all methods that the plan adds."""
    fields = "cull", "build", "optimise", "update"
    added = {f: method for f in fields if (method := getattr(plan, f)) not in (None, getattr(Plan(), f))}
    parts = [{field: method} for field, method in added.items()]
    if plan.cull and plan.update:
        parts.append({"cull": "grid32", "update": plan.update})
    return parts


def trace_small(plan: Plan, view: tuple[Camera, list], spp: int = 1) -> None:
    """Trace the shadows of a view of the small scene by a plan."""
    make, triangles, (camera, lights) = accelerator_of(plan, 2), small_scene().triangles(0.0, 2), view
    samples = [light_samples(light, spp) for light in lights]
    queries = shadow_queries(triangles, primary_visibility(triangles, camera, None, 2), lights, samples, 0, 2)
    if make.showing is None:  # all triangles: culling leaves too few to reach all of a builder
        make.build(triangles)
    make.answer_all(make.build(triangles, make.culled(triangles, queries), make.show(triangles, queries)), queries)


def trace_all_ways(counters: bool) -> None:
    """Trace the lights of the small scene in each way that `auto` may choose, over the trees that it may build."""
    triangles, (camera, lights) = small_scene().triangles(0.0, 2), small_view()
    queries = shadow_queries(
        triangles, primary_visibility(triangles, camera, None, 2), lights, [light_samples(s, 1) for s in lights]
    )
    for build in (BUILDERS[QUICK].build, UPDATERS["refit"].keep(BUILDERS[GOOD].build).update):
        forms = TreeForms(build(triangles.vertices, 2), 2)
        for name, way in STRATEGIES.items():
            for query in queries:
                if way.suits(query, forms.box):
                    answer_query(name, forms, query, 2, new_counters() if counters else None)


# --- The engine: the one door to all questions about a scene, and all that is remembered between them -----------------


_KEPT = 8  # engines of other plans that an engine remembers


class Engine:
    """Answers questions about one scene by one plan, and keeps what it builds and learns.

    Threads of Python may share an engine. Questions of rays in memory run side by side; others take turns, and hold
    `lock` meanwhile.

    Parameters
    ----------
    scene : Scene, PagedScene, or anything that `antumbra.load` takes
        A scene in memory or in a store, a path, or a mesh of another library.
    plan : str, Plan or None
        The methods, such as ``"bsah+single"``. None: ``"auto"``; for a scene in a store ``"bsah+chcrt"``. Ray lists in
        memory have a tree of their own.
    threads : int or None
        None: all cores.
    max_memory : int or None
        Limit in bytes on the memory of the process at any time, for a scene in a store; None: that of the scene, or
        4 GiB.
    gbuffer : "raster", "rays" or "auto"
        The method of `surfaces`; all give the same bits. "auto" is raster, or rays through a tree that an earlier
        question has kept, whichever was faster. A store, and a camera that is not perspective, always use rays.

    Raises
    ------
    InputError
        If a value is out of range, the plan is unknown, or the plan cannot answer for a scene in a store.
    """

    def __init__(
        self, scene: Any, plan: str | Plan | None = None, threads: int | None = None,
        max_memory: int | None = None, *, gbuffer: str = AUTO,
    ):  # fmt: skip
        data = data_of(scene)
        choice(gbuffer, "gbuffer", METHODS)
        limit = getattr(scene, "max_memory", None) if max_memory is None else max_memory
        self._start(data, _trees_of(data), plan, threads, limit, gbuffer)

    def __getstate__(self) -> tuple:
        """A pickle has what an engine is made of, and makes everything else again."""
        return self.data, self.plan, self.threads, self.max_memory, self.source.gbuffer

    def __setstate__(self, state: tuple) -> None:
        self._start(state[0], _trees_of(state[0]), *state[1:])

    def _start(self, data: SceneData, trees: SceneTrees | None, plan, threads, max_memory, gbuffer: str) -> None:
        self.data, self.threads = data, thread_count(threads)
        self.plan = parse_plan(default_plan_of(data) if plan is None else plan)
        self.max_memory, self._trees, self.lock = max_memory, trees, threading.RLock()
        self.accelerator: Accelerator = accelerator_of(self.plan, self.threads)
        self.source: RenderSource = self._new_source(gbuffer)
        self._frame, self._n_faces = tuple(data.origin.tolist()), data.n_triangles
        self._others: dict[tuple, Engine] = {}
        self._warm = False  # its kernels are compiled

    def _new_source(self, gbuffer: str) -> RenderSource:
        if self._trees is None:
            return _paged()(self.data, self.accelerator, self.max_memory)
        if self.max_memory is not None:
            raise InputError(f"max_memory is for scenes in a store, and {self.data.name} is in memory; leave it out")
        assert isinstance(self.data, MemoryData)
        return InMemory(self.data, self.accelerator, self._trees, gbuffer)

    def with_options(self, plan: str | Plan | None, threads: int | None, max_memory: int | None) -> "Engine":
        """The engine of another plan, number of threads or limit, which shares this one's triangles and trees.

        None: as in this engine. Of a store, only the engine that was asked for last keeps chunks: those of others would
        count against the limit on memory.
        """
        if plan is threads is max_memory is None and not self._others:
            return self
        own = self.plan, self.threads, self.max_memory
        wanted = (
            self.plan if plan is None else parse_plan(plan),
            self.threads if threads is None else thread_count(threads),
            self.max_memory if max_memory is None else byte_count(max_memory, "max_memory", 1),
        )
        with self.lock:
            if wanted == own:
                if self.source.in_store:
                    self._others.clear()
                return self
            found = self._others.pop(wanted, None)
            if self.source.in_store:
                self._others.clear()
                self.source.release()
            if found is None:
                found = Engine.__new__(Engine)
                found._start(self.data, self._trees, *wanted, AUTO)
            self._others[wanted] = found  # the last one is the latest
            if len(self._others) > _KEPT:
                self._others.pop(next(iter(self._others)))
            return found

    def occluded(
        self, origins, directions=None, tmin=0.0, tmax=np.inf, skip_face=None, time=0.0, *, targets=None,
        cull_faces=None, threads=None,
    ) -> np.ndarray:  # fmt: skip
        """(...) bool: whether a triangle blocks each ray; `antumbra.Scene.occluded` documents the parameters."""
        rays = rays_of(
            origins, directions, tmin, tmax, skip_face, cull_faces, self._frame, self._n_faces, targets
        )  # fmt: skip
        return self._hits(rays, True, time, threads).blocked.reshape(rays.shape)

    def closest_hit(
        self, origins, directions=None, tmin=0.0, tmax=np.inf, skip_face=None, time=0.0, *, cull_faces=None,
        threads=None,
    ) -> Hit:  # fmt: skip
        """The nearest hits of rays; `antumbra.Scene.closest_hit` documents the parameters."""
        rays = rays_of(origins, directions, tmin, tmax, skip_face, cull_faces, self._frame, self._n_faces)
        found = self._hits(rays, False, time, threads)
        faces = HitFaces(*(array.reshape(rays.shape) for array in (found.t, found.face, found.u, found.v)))
        data = self.data
        return Hit.of_scene(faces, self._finder(rays, faces.face, self._moment(time)), lambda: data.object_of_face)

    def _finder(
        self, rays: RayArguments, face: np.ndarray, moment: float
    ) -> Callable[[], tuple[Triangles, np.ndarray]]:
        """A function that gives the triangles of hits: those at hand, or those that a store is asked for again."""
        if not self.source.in_store:
            met = self.source.triangles_hit(rays, face, moment)
            return lambda: met
        own = rays.copied()

        def find():
            with self.lock:
                return self.source.triangles_hit(own, face, moment)

        return find

    def _hits(self, rays: RayArguments, any_hit: bool, time, threads: int | None) -> HitArrays:
        moment = self._moment(time)
        threads = self.threads if threads is None else thread_count(threads)
        if not self.source.in_store:
            return self.source.trace_rays(rays, any_hit, moment, threads)
        engine = self.with_options(None, threads, None)
        with engine.lock:
            engine.source.warm_up()
            return engine.source.trace_rays(rays, any_hit, moment)

    def _moment(self, time) -> float:
        return 0.0 if type(time) is float and time == 0.0 else self.data.clamped(time)

    def surfaces(self, camera: Camera, time: float = 0.0) -> GBuffer:
        """The G-buffer of a camera at a time in seconds: the surfaces that its pixels see."""
        instance(camera, Camera, "camera")
        with self.lock:
            self._warm_up()
            self.source.begin(FrameMemory(0, 0, 0))
            triangles, whole = self.source.moment(self._moment(time))
            if whole is None and (camera.listed or self.source.gbuffer == "rays"):
                whole = self.accelerator.of_all(triangles)
            surfaces = self.source.look(camera, triangles, whole)
            return surfaces.gbuffer._replace(face=surfaces.ids)

    def visibility(
        self, receivers: Receivers, lights: Light | Sequence[Light], *, spp: int = 16,
        sampler: str = "larcher-pillichshammer", cull_faces: str | None = None, time: float = 0.0,
        progress: Progress | bool | None = None,
    ) -> Visibility:  # fmt: skip
        """Which samples of lights a list of n receivers sees: a `Visibility` of shape (n, lights).

        `antumbra.visibility` documents the parameters. Receivers are made by `Receivers.on_surface` and `in_space`.
        """
        instance(receivers, Receivers, "receivers")
        lights = [without_interleave(light) for light in check_lights(lights, self.data.up)]
        samples = [light_samples(light, spp, sampler) for light in lights]
        for light in lights:
            if light.domain == "hemisphere" and not receivers.normals.size and receivers.n:
                raise InputError(f"{type(light).__name__} is seen around a normal; give the points' normals")
        with show_progress("tracing shadow rays", progress) as heard:
            found = self.shadows(receivers, lights, samples, cull_value(cull_faces), time, progress=heard)
        return visibility_of([bits for _, bits in found], [each.shape[1] for each in samples])

    def shadows(
        self, receivers: Receivers, lights: Sequence[Light], samples: Sequence[np.ndarray], facing: int = 0,
        time: float = 0.0, *, later: int = 0, progress: Progress | None = None,
    ) -> list[tuple[ShadowQuery, np.ndarray]]:  # fmt: skip
        """The shadow query of each light from receivers, and its bits: (h, w, ceil(n / 64)) uint64.

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
            About so many rays follow in other questions. The plan `auto` builds better trees for more rays.
        progress : function of (done, total), optional

        Raises
        ------
        InputError
            If points or lights are too far from the scene, or memory is too small.
        """
        with self.lock:
            make, source = self.accelerator, self.source
            self._warm_up()
            if source.in_store:
                needs = [points_memory(receivers.n, *each) for each in zip(lights, samples)]
                source.begin(FrameMemory(*map(sum, zip(*needs))))
            make.begin(receivers.n * sum(each.shape[1] for each in samples), later)
            triangles, ready = source.for_points(self._moment(time))
            queries = self._queries(triangles, receivers, lights, samples, facing)
            if ready is None:  # the tree depends on the queries
                ready = make.build(triangles, make.culled(triangles, queries), make.show(triangles, queries))
            ready.begin()
            return list(zip(queries, make.answer_all(ready, queries, None, split_progress(progress, len(queries)))))

    def queries(
        self, receivers: Receivers, lights: Sequence[Light], samples: Sequence[np.ndarray], facing: int = 0,
        time: float = 0.0,
    ) -> list[ShadowQuery]:  # fmt: skip
        """The queries of `shadows`, without their bits."""
        with self.lock:
            return self._queries(self.source.moment(self._moment(time))[0], receivers, lights, samples, facing)

    def frame_tracer(self) -> FrameTracer:
        """Traces the rays of one frame. Hold `lock` from its first call to the last."""
        return FrameTracer(self.source, self.accelerator)

    def accelerated(self, time: float = 0.0) -> Accelerated:
        """The triangles and the tree of this plan at a time, whose tree does not depend on the question.

        Raises
        ------
        InputError
            If the scene is in a store.
        """
        if self._trees is None:
            raise self.data.refusal()
        return self._trees.of(self.accelerator, self._moment(time))

    def _queries(self, triangles: Triangles, receivers: Receivers, lights, samples, facing: int) -> list[ShadowQuery]:
        origins, sides, normals = receivers
        box = self.source.box(triangles)
        reach = reach_of(box, origins, self.threads) if origins.size else 1.0
        corners, no_faces = triangles.vertices.reshape(-1, 9), np.full(sides.shape, -1, np.int32)
        return [
            ShadowQuery(
                origins, no_faces, sides, normals, corners, place(light, triangles.origin, box, reach), sets, facing,
                no_faces,
            )
            for light, sets in zip(lights, samples)
        ]  # fmt: skip

    def _warm_up(self) -> None:
        """Compile the kernels of shadows and surfaces by this plan."""
        if not self._warm:
            warm_up(self.plan, compiled_for(self.source.gbuffer))
            self.source.warm_up()
            self._warm = True


def default_plan_of(data: SceneData) -> str:
    """The plan of an engine of a scene for which none is named."""
    return InMemory.default_plan if isinstance(data, MemoryData) else _paged().default_plan


def _trees_of(data: SceneData) -> SceneTrees | None:
    return SceneTrees(data) if isinstance(data, MemoryData) else None


def _paged():
    from .paged_source import Paged  # imported late: scenes in memory start sooner without it

    return Paged
