"""The engine: answers all queries about a scene by one plan, and caches what later queries can reuse.

The kernels of a plan are compiled before its first query.
"""

import threading
from collections.abc import Callable, Sequence
from functools import partial
from typing import TYPE_CHECKING, Any, TypeAlias, TypeVar, cast

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..base.checks import as_array, byte_count, checked_instance, choice, whole_number
from ..base.errors import InputError
from ..base.forks import is_stuck, renew_after_fork
from ..base.progress import ProgressCallback, show_progress, split_progress
from ..kernels.parallel import thread_count
from ..query.gbuffer import GBuffer
from ..query.light_samples import light_samples
from ..query.query_bounds import place, reach_of
from ..query.ray_list import RayArguments, TracedRays, cull_value, rays_of, segments_between
from ..query.receivers import Receivers
from ..query.shadow_query import ShadowQuery
from ..scene.camera import Camera
from ..scene.instance_data import InstanceData
from ..scene.light_lists import without_interleave
from ..scene.lights import Light, check_lights
from ..scene.scene_data import MemoryData, SceneData
from ..scene.triangles import AllHits, Hit, HitFaces, HitFilter, Triangles
from ..trace.rays.all_hits import INSIDE, ON_SURFACE, SURFACES, TRIANGLES
from ..trace.transmission import TracedQuery, transmission
from .accelerator import Accelerated, Accelerator, SceneTrees
from .auto_accelerator import accelerator_of
from .frame_tracer import FrameMemory, FrameTracer, RenderSource, points_memory
from .plan import Plan, parse_plan
from .precompilation import precompile, precompile_plan
from .primary_visibility import AUTO, METHODS, precompiled_method
from .ray_queries import RayQueries
from .scene_reading import data_of
from .sources.in_memory_source import InMemory
from .sources.instanced_source import Instanced, SharedInstances, traces_instances
from .sources.terrain_shadows import TerrainShadows
from .visibility import Visibility, visibility_of

if TYPE_CHECKING:
    from ..scene.moved_geometry import ObjectChoice
    from ..store.store_file import StoreData
    from .sources.paged_source import Paged


_MAX_OTHER_ENGINES = 8  # engines of other plans that an engine caches

MAX_HITS = (1 << 31) - 1
"""Largest value of `max_hits`, and more than a scene has faces."""

MAX_COORDINATE = 1e38
"""Points for `contains` must be closer to 0, so that float32 can represent them."""

MERGES = {"none": TRIANGLES, "surface": SURFACES}
"""Rules by which hits are counted."""

_T = TypeVar("_T")

_Options: TypeAlias = tuple[Plan, int, int | None]
"""Plan, threads and memory limit."""

_State: TypeAlias = tuple[SceneData, Plan, int, int | None, str]
"""Scene data, plan, threads, memory limit and G-buffer method."""


class Engine(RayQueries):
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
        self._updates = threading.Lock()  # held while the geometry is moved; queries do not wait for it
        self.accelerator: Accelerator = accelerator_of(self.plan, self.threads)
        self.source: RenderSource = self._new_source(gbuffer)
        self.terrain = TerrainShadows(data)
        self._frame, self._n_faces = tuple(data.origin.tolist()), data.n_triangles
        self._others: dict[_Options, Engine] = {}  # least recently used first
        self._warm = False  # whether its kernels are compiled
        renew_after_fork(self)

    def _after_fork(self) -> None:
        """Start again without the trees that a query in another thread was using or changing."""
        if is_stuck(self.lock):
            if self._trees is not None:
                self._trees.clear()
            self._start(self.data, self._trees, self.plan, self.threads, self.max_memory, self.source.gbuffer)

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

    @property
    def engine(self) -> "Engine":
        """Itself."""
        return self

    def _any_hit(
        self, origins: ArrayLike, directions: ArrayLike | None, hits: HitFilter, targets: ArrayLike | None,
        time: float, threads: int | None,
    ) -> NDArray[np.bool_]:  # fmt: skip
        rays = rays_of(origins, directions, hits, self._frame, self._n_faces, targets)
        return self._traced(rays, True, time, threads).hits.blocked.reshape(rays.shape)

    def _closest_hit(
        self, origins: ArrayLike, directions: ArrayLike | None, hit_filter: HitFilter, time: float, threads: int | None
    ) -> Hit:
        rays = rays_of(origins, directions, hit_filter, self._frame, self._n_faces)
        hits, triangles = self._traced(rays, False, time, threads)
        faces = HitFaces(*(array.reshape(rays.shape) for array in (hits.t, hits.face, hits.u, hits.v)))
        data = self.data
        return Hit.of_scene(faces, self._finder(rays, faces.face, triangles, time), lambda: data.object_of_face)

    def _all_hits(
        self, origins: ArrayLike, directions: ArrayLike | None, hits: HitFilter, targets: ArrayLike | None,
        max_hits: int | None, time: float, threads: int | None,
    ) -> AllHits:  # fmt: skip
        if max_hits is not None:
            max_hits = whole_number(max_hits, "max_hits", 1, MAX_HITS)
        rays = rays_of(origins, directions, hits, self._frame, self._n_faces, targets)
        moment = self._moment(time)
        return self._ask(threads, lambda source: source.all_hits(rays, max_hits, TRIANGLES, moment, threads))

    def _count_hits(
        self, origins: ArrayLike, directions: ArrayLike | None, hits: HitFilter, targets: ArrayLike | None, merge: str,
        time: float, threads: int | None,
    ) -> NDArray[np.int64]:  # fmt: skip
        rule = MERGES[choice(merge, "merge", MERGES)]
        rays = rays_of(origins, directions, hits, self._frame, self._n_faces, targets)
        moment = self._moment(time)
        return self._ask(threads, lambda source: source.count_hits(rays, rule, moment, threads)).reshape(rays.shape)

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
        segments, moment = segments_between(begin, end, skip_face), self._moment(time)
        return self._ask(threads, lambda source: source.all_hits(segments, None, TRIANGLES, moment, threads))

    def _inside(self, points: "ArrayLike", time: float, threads: int | None) -> NDArray[np.bool_]:
        array, up = as_array(points, "points", strided=True), np.eye(3)["xyz".index(self.data.up)]
        if array.ndim < 1 or array.shape[-1] != 3:
            raise InputError(f"points must have shape (..., 3), not {array.shape}")
        if not np.abs(array).max(initial=0.0) < MAX_COORDINATE:
            first = int(np.argmin((np.abs(array) < MAX_COORDINATE).reshape(-1, 3).all(1)))
            raise InputError(f"points are NaN, infinite or beyond float32 (point {first})")
        rays = rays_of(array, up, HitFilter(0.0, np.inf), self._frame, self._n_faces)
        moment = self._moment(time)
        counts = self._ask(threads, lambda source: source.count_hits(rays, INSIDE, moment, threads))
        inside: NDArray[np.bool_] = (counts >= ON_SURFACE) | (counts % 2 == 1)
        return inside.reshape(rays.shape)

    def _ask(self, threads: int | None, query: Callable[[RenderSource], _T]) -> _T:
        """The answer of the source to a query of rays by some threads. A store is locked meanwhile."""
        if not self.source.in_store:
            return query(self.source)
        engine = self.with_options(None, threads, None)
        with engine.lock:
            engine.source.warm_up()
            return query(engine.source)

    def _finder(
        self, rays: RayArguments, face: np.ndarray, triangles: Triangles | None, time: float
    ) -> Callable[[], tuple[Triangles, np.ndarray]]:
        """A function that returns the triangles of hits: those in memory, or those found in a store by a new query."""
        if isinstance(self.source, Instanced):
            return partial(self.source.triangles_hit, rays, face.copy(), self._moment(time))
        if triangles is not None:
            hit = triangles, face
            return lambda: hit
        moment = self._moment(time)
        if isinstance(self.source, InMemory):  # over terrain, triangles are made only if they are asked for
            return lambda: (cast(SceneTrees, self._trees).triangles(moment, self.threads), face)
        copy, source = rays.copied(), cast("Paged", self.source)

        def find() -> tuple[Triangles, np.ndarray]:
            with self.lock:
                return source.triangles_hit(copy, face, moment)

        return find

    def _traced(self, rays: RayArguments, any_hit: bool, time: float, threads: int | None) -> TracedRays:
        moment = self._moment(time)
        threads = self.threads if threads is None else thread_count(threads)
        if isinstance(self.source, InMemory) and self.source.ray_lists.plan is None:
            hits = self.terrain.trace_rays(self.plan, rays, any_hit, threads)
            if hits is not None:
                return TracedRays(hits, None)
        return self._ask(threads, lambda source: source.trace_rays(rays, any_hit, moment, threads))

    def _moment(self, time: float) -> float:
        return 0.0 if type(time) is float and time == 0.0 else self.data.clamped(time)

    def update(
        self,
        vertices: "ArrayLike | None" = None,
        objects: "ObjectChoice" = None,
        transform: "ArrayLike | None" = None,
        threads: int | None = None,
    ) -> None:
        """Move the geometry of the scene; `antumbra.Scene.update` documents the parameters."""
        if not self.source.in_store:
            precompile("update")
        with self._updates:
            self.data.update(vertices, objects, transform, self.threads if threads is None else threads)

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
        month: int | None = None,
        known: Sequence[NDArray[np.uint64]] | None = None,
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
        month : int, optional
            0 to 11, January to December: the month whose transmittances count. None: their mean over the year.
        known : sequence of (h, w, ceil(n / 64)) uint64, optional
            The segments to each light that need not be traced, as set bits; their bits in the answer are unspecified.
            They include all segments that the receivers' own surfaces block.
        progress : function of (done, total), optional

        Raises
        ------
        InputError
            If points or lights are too far from the scene, a light needs normals that the receivers lack, or memory is
            too small.
        """
        for light in lights:
            if light.domain == "hemisphere" and not receivers.normals.size and receivers.n:
                raise InputError(f"{type(light).__name__} needs surface normals; give the points' normals")
        with self.lock:
            if self.terrain.serves(self.plan, receivers, lights, receivers.n * sum(each.shape[1] for each in samples)):
                return self.terrain.shadows(receivers, lights, samples, facing, self.threads, progress)
            accelerator, source = self.accelerator, self.source
            self._warm_up()
            if source.in_store:
                needs = [points_memory(receivers.n, *each) for each in zip(lights, samples)]
                source.begin(FrameMemory(*map(sum, zip(*needs))))
            accelerator.begin(receivers.n * sum(each.shape[1] for each in samples), later)
            triangles, accelerated = source.for_points(self._moment(time))
            queries = self._queries(triangles, receivers, lights, samples, facing)
            if accelerated is None:  # the tree depends on the queries
                accelerated = accelerator.tree_for(triangles, queries)
                source.keep_for_points(accelerated)
            accelerated.begin()
            if accelerated.cutouts is not None:
                cutouts = accelerated.cutouts.in_month(month)
                accelerated = accelerated._replace(cutouts=cutouts.as_holes() if whole else cutouts)
            steps = split_progress(progress, len(queries))
            bits = accelerator.answer_all(accelerated, queries, None, steps, known)
            return [
                TracedQuery(q, b, transmission(accelerated.cutouts, q, b, self.threads)) for q, b in zip(queries, bits)
            ]

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
        with self.lock:
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
            precompile_plan(self.plan, precompiled_method(self.source.gbuffer))
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
    from .sources.paged_source import Paged  # imported late: scenes in memory start faster without it

    return Paged
