"""The engine: answers all queries about a scene by one plan, and caches what later queries can reuse.

The kernels of a plan are compiled before its first query.
"""

import threading
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, TypeAlias, cast

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..base.checks import byte_count, checked_instance, choice, whole_number
from ..base.errors import InputError
from ..base.forks import is_stuck, renew_after_fork
from ..base.progress import ProgressCallback, show_progress
from ..devices.device_list import default_device, may_have_card, using_device
from ..kernels.parallel import thread_count
from ..query.gbuffer import GBuffer
from ..query.light_samples import light_samples
from ..query.point_list import PointArguments, points_of
from ..query.ray_list import cull_value, failing, rays_along, rays_of, segments_between
from ..query.receivers import Receivers
from ..query.shadow_query import ShadowQuery
from ..scene.camera import Camera
from ..scene.light_lists import without_interleave
from ..scene.lights import Light, check_lights
from ..scene.scene_data import SceneData
from ..scene.triangles import AllHits, ClosestPoints, Hit, HitFaces, HitFilter
from ..trace.rays.all_hits import SURFACES, TRIANGLES
from ..trace.transmission import TracedQuery
from .accelerator import Accelerated, Accelerator
from .auto_accelerator import accelerator_of
from .containment import inside_of, with_note
from .device_plans import plan_on
from .frame_tracer import FrameTracer
from .plan import DEFAULT_PLAN, Plan, parse_plan
from .precompilation import precompile
from .primary_visibility import AUTO, METHODS, RAYS
from .ray_queries import RayQueries
from .scene_reading import data_of
from .sources.few_points import FewPoints
from .sources.in_memory_source import RayLists, SharedMemory
from .sources.instanced_source import SharedInstances
from .sources.point_shadows import PlanKernels, TreeShadows, queries_in
from .sources.source_protocols import (
    CameraView,
    FrameMemory,
    HitSource,
    PointQuery,
    PointSource,
    SharedTrees,
    SourceSettings,
    TreeHits,
    moment_of,
)
from .sources.terrain_shadows import TerrainShadows
from .visibility import Visibility, visibility_of

if TYPE_CHECKING:
    from ..devices.arrays import DeviceArray
    from ..scene.moved_geometry import ObjectChoice
    from .sources.device_ray_lists import DeviceRayLists


_MAX_OTHER_ENGINES = 8  # engines of other plans that an engine caches

MAX_HITS = (1 << 31) - 1
"""Largest value of `max_hits`, and more than a scene has faces."""

MERGES = {"none": TRIANGLES, "surface": SURFACES}
"""Rules by which hits are counted."""

_Options: TypeAlias = tuple[Plan, int, int | None]
"""Plan, threads and memory limit."""

_State: TypeAlias = tuple[SceneData, Plan, int, int | None, str]
"""Scene data, plan, threads, memory limit and G-buffer method."""


class Engine(RayQueries):
    """Answers queries about one scene by one plan, and caches trees and measurements between them.

    With a device, `occluded` and `closest_hit` also take rays in arrays on that device, of PyTorch, CuPy, JAX or other
    libraries with DLPack or ``__cuda_array_interface__``, float32 or float64. Their results are then
    `antumbra.devices.arrays.DeviceArray` there: for `closest_hit` a tuple of t, face, u and v. `update` takes such
    vertices, which are read before it returns, and copied to the host only for what runs there.

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
        limit, or the default of `PagedScene.max_memory`. On a device, the limit on the memory taken there; None: all
        that is free.
    gbuffer : "raster", "rays" or "auto"
        The method of `surfaces`; all give the same bits. "auto": rasterise; once a tree is cached, use whichever is
        faster; on a device, rays. "raster" leaves this to the CPU. Stores, and cameras that are not perspective, always
        use rays.
    device : str or None
        The device that traces shadow rays and ray lists: ``"cuda"``, ``"cuda:1"``, ``"opencl"``, or ``"cpu"`` for none.
        None: the one in the environment variable ``ANTUMBRA_DEVICE``, if there is neither a plan. It never changes a
        bit. Stores and lists of all hits are traced on the CPU.

    Raises
    ------
    InputError
        If a value is out of range, the plan is unknown, the plan does not support stores, or there is no such device.

    Examples
    --------
    >>> engine = at.Engine(at.examples.temple(), plan="bsah+wide")
    >>> engine.occluded([[0, 1, 0], [0, 1, 14]], (0, 1, 0))  # inside, and in front
    array([ True, False])
    """

    def __init__(
        self,
        scene: Any,
        plan: str | Plan | None = None,
        threads: int | None = None,
        max_memory: int | None = None,
        *,
        gbuffer: str = AUTO,
        device: str | None = None,
    ):
        data = data_of(scene)
        choice(gbuffer, "gbuffer", METHODS)
        limit = getattr(scene, "max_memory", None) if max_memory is None else max_memory
        with using_device(device):
            self._start(data, _shared_kind(data)(data), chosen_plan(data, plan, device), threads, limit, gbuffer)

    def __getstate__(self) -> _State:
        """Pickle the settings; everything else is rebuilt."""
        return self.data, self.plan, self.threads, self.max_memory, self.source.gbuffer

    def __setstate__(self, state: _State) -> None:
        self._start(state[0], _shared_kind(state[0])(state[0]), *state[1:])

    def _start(
        self,
        data: SceneData,
        shared: SharedTrees,
        plan: str | Plan | None,
        threads: int | None,
        max_memory: int | None,
        gbuffer: str,
    ) -> None:
        self.data, self.threads = data, thread_count(threads)
        self.plan = parse_plan(default_plan_of(data) if plan is None else plan)
        self.max_memory, self._shared, self.lock = max_memory, shared, threading.RLock()
        self._updates = threading.Lock()  # held while the geometry is moved; queries do not wait for it
        self._others: dict[_Options, Engine] = {}  # least recently used first
        self._frame, self._n_faces = tuple(data.origin.tolist()), data.n_triangles
        self.accelerator: Accelerator = accelerator_of(self.plan, self.threads)
        self.source = shared.source(
            self.accelerator, SourceSettings(gbuffer, max_memory, self.lock, self._others.clear)
        )
        self._kernels = PlanKernels(self.source, self.accelerator)
        self._rays: HitSource = self.source.ray_lists  # the first of the chain of sources, see `source_protocols`
        self._points: PointSource = TreeShadows(self.source, self.accelerator, self._kernels)
        self.terrain: TerrainShadows | None = None
        self._device_rays: DeviceRayLists | None = None
        chooses = str(self.plan) == DEFAULT_PLAN
        if self.plan.device is not None and data.resident and not (data.instanced and self.source.geometry is None):
            from .sources import device_ray_lists  # imported late: most engines use no device

            self._rays = self._device_rays = device_ray_lists.DeviceRayLists(shared.flat(), self.accelerator)
        elif str(self.plan) == shared.default_plan and data.terrain is not None:
            trees = cast(TreeHits, self._rays)  # in memory, or in a store
            self.terrain = TerrainShadows(data, trees, self._points, self.threads, self.source)
            self._rays = self._points = self.terrain
        elif chooses and may_have_card() and default_device() is None:
            from .sources.card_rays import CardRays

            self._rays = CardRays(shared.flat(), self.threads, self._rays)
        geometry, others = self.source.geometry, self.terrain or self._device_rays
        self._few = None if geometry is None or not chooses or others else FewPoints(geometry, self._rays)
        renew_after_fork(self)

    def _after_fork(self) -> None:
        """Start again without the trees that a query in another thread was using or changing."""
        if is_stuck(self.lock):
            self._shared.clear()
            self._start(self.data, self._shared, self.plan, self.threads, self.max_memory, self.source.gbuffer)

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
                if self.source.memory is not None:
                    self._others.clear()
                return self
            engine = self._others.pop(requested, None)
            if self.source.memory is not None:
                self._others.clear()
                self.source.memory.release()
            if engine is None:
                engine = Engine.__new__(Engine)
                engine._start(self.data, self._shared, *requested, AUTO)
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
        if self._device_rays is not None and self._device_rays.takes(origins):
            resident = self._resident(origins, directions, targets, hits, True, time, threads)
            return cast(NDArray[np.bool_], resident[0])
        rays = rays_of(origins, directions, hits, self._frame, self._n_faces, targets, self._moment(time))
        blocked = self._rays.trace_rays(rays, True, self._count(threads)).hits.blocked
        return blocked if len(rays.shape) == 1 else blocked.reshape(rays.shape)

    def _closest_hit(
        self, origins: ArrayLike, directions: ArrayLike | None, hit_filter: HitFilter, time: float, threads: int | None
    ) -> Hit:
        if self._device_rays is not None and self._device_rays.takes(origins):
            face, t, u, v = self._resident(origins, directions, None, hit_filter, False, time, threads)
            return cast(Hit, HitFaces(*(cast(np.ndarray, each) for each in (t, face, u, v))))
        rays = rays_of(origins, directions, hit_filter, self._frame, self._n_faces, None, self._moment(time))
        try:
            hits, find = self._rays.trace_rays(rays, False, self._count(threads))
        except InputError:
            rays, failed = rays.without_failed()
            if not len(failed):
                raise
            hits, find = failing(self._rays.trace_rays(rays, False, self._count(threads)), failed)
        faces = HitFaces(hits.t, hits.face, hits.u, hits.v)
        if len(rays.shape) != 1:
            faces = HitFaces(*(array.reshape(rays.shape) for array in (hits.t, hits.face, hits.u, hits.v)))
        assert find is not None
        data = self.data
        return Hit.of_scene(faces, find, lambda: data.object_of_face)

    def _all_hits(
        self, origins: ArrayLike, directions: ArrayLike | None, hits: HitFilter, targets: ArrayLike | None,
        max_hits: int | None, merge: str, time: float, threads: int | None,
    ) -> AllHits:  # fmt: skip
        rule = MERGES[choice(merge, "merge", MERGES)]
        if max_hits is not None:
            max_hits = whole_number(max_hits, "max_hits", 1, MAX_HITS)
        rays = rays_of(origins, directions, hits, self._frame, self._n_faces, targets, self._moment(time))
        return self.source.ray_lists.all_hits(rays, max_hits, rule, self._count(threads))

    def _count_hits(
        self, origins: ArrayLike, directions: ArrayLike | None, hits: HitFilter, targets: ArrayLike | None, merge: str,
        time: float, threads: int | None,
    ) -> NDArray[np.int64]:  # fmt: skip
        rule = MERGES[choice(merge, "merge", MERGES)]
        rays = rays_of(origins, directions, hits, self._frame, self._n_faces, targets, self._moment(time))
        return self.source.ray_lists.count_hits(rays, rule, self._count(threads)).reshape(rays.shape)

    def _count_points(self, rays: ArrayLike, apart: bool = False, threads: int | None = None) -> NDArray[np.int64]:
        """(n,) int64: at how many t rays, (n, 6), hit something; -1: unknown.

        Only for scenes in memory; errors as for `occluded`.

        apart : whether hits at one t may count several times, so that their number is unknown
        """
        arguments = rays_of(rays, None, HitFilter(0.0, np.inf), self._frame, self._n_faces, None, self._moment(0.0))
        return cast(RayLists, self.source.ray_lists).count_points(arguments, apart, self._count(threads))

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
        segments = segments_between(begin, end, skip_face, self._moment(time))
        return self.source.ray_lists.all_hits(segments, None, TRIANGLES, self._count(threads))

    def _inside(self, points: "ArrayLike", time: float, threads: int | None) -> NDArray[np.bool_]:
        return self._contained(points_of(points, self._frame).checked(), time, threads)

    def _contained(self, points: PointArguments, time: float, threads: int | None) -> NDArray[np.bool_]:
        moment = self._moment(time)
        bodies = self.source.ray_lists.bodies(moment)
        along = np.eye(3)["xyz".index(self.data.up)] if bodies.along is None else bodies.along
        rays = rays_along(points.points, along, points.frame, moment)
        if bodies.open_edges or self.data.notes:
            self.data.notes = with_note(self.data.notes, self.data.name, bodies.open_edges)
        inside = inside_of(bodies, rays, self._count(threads))
        return inside if len(rays.shape) == 1 else inside.reshape(rays.shape)

    def _closest_points(self, points: "ArrayLike", time: float, threads: int | None) -> ClosestPoints:
        return self._closest_to(*points_of(points, self._frame).without_failed(), time, threads)

    def _closest_to(
        self, points: PointArguments, failed: NDArray[np.intp], time: float, threads: int | None
    ) -> ClosestPoints:
        """The closest points; `failed`: the indices of points that stand for others, which fail."""
        found = self.source.ray_lists.closest_points(points.local(), self._moment(time), self._count(threads))
        found.position[:] += self._frame
        if len(failed):
            found.distance[failed], found.position[failed] = np.nan, np.nan
            found.face[failed], found.u[failed], found.v[failed] = -1, 0.0, 0.0
        if len(points.shape) == 1:
            return found
        arrays: list[Any] = [array.reshape((*points.shape, *array.shape[1:])) for array in found]
        return ClosestPoints(*arrays)

    def _signed_distance(self, points: "ArrayLike", time: float, threads: int | None) -> NDArray[np.float64]:
        checked, failed = points_of(points, self._frame).without_failed()
        distance = self._closest_to(checked, failed, time, threads).distance
        return np.where(self._contained(checked, time, threads) & (distance > 0.0), -distance, distance)

    def _count(self, threads: int | None) -> int:
        """The number of threads of a query."""
        return self.threads if threads is None else thread_count(threads)

    def _resident(
        self,
        origins: Any,
        directions: Any,
        targets: Any,
        hits: HitFilter,
        any_hit: bool,
        time: float,
        threads: int | None,
    ) -> "tuple[DeviceArray, ...]":
        """The hits of rays in arrays on the engine's device."""
        assert self._device_rays is not None
        return self._device_rays.trace_resident(
            origins, directions, targets, hits, self._frame, any_hit, self._moment(time), self._count(threads)
        )

    def _moment(self, time: float) -> float:
        return 0.0 if type(time) is float and time == 0.0 else self.data.clamped(time)

    def update(
        self,
        vertices: "ArrayLike | None" = None,
        objects: "ObjectChoice" = None,
        transform: "ArrayLike | None" = None,
        threads: int | None = None,
    ) -> None:
        """Move the geometry of the scene; `antumbra.Scene.update` documents the parameters.

        After vertices from a device in more digits than float32 has in the scene's frame, a transform is refused.
        """
        if self.source.geometry is not None:
            precompile("update")
        if self._device_rays is not None and self._device_rays.takes(vertices):
            vertices = cast("ArrayLike", self._device_rays.vertices(vertices))
        with self._updates:
            self.data.update(vertices, objects, transform, self.threads if threads is None else threads)

    def surfaces(self, camera: Camera, time: float = 0.0) -> GBuffer:
        """The G-buffer of a camera at a time in seconds: the visible surface at each pixel."""
        checked_instance(camera, Camera, "camera")
        with self.lock:
            self._kernels.make_ready()
            if self.source.memory is not None:
                self.source.memory.begin(FrameMemory(0, 0, 0))
            triangles, tree = moment_of(self.source, self._moment(time))
            if tree is None and (camera.listed or self.source.gbuffer == RAYS):
                tree = self.accelerator.prepare_all(triangles)
            surfaces = self.source.look(CameraView(camera, triangles, tree, slice(0, camera.height)))
            return surfaces.gbuffer._replace(face=surfaces.ids)

    def visibility(
        self,
        receivers: Receivers,
        lights: Light | Sequence[Light],
        *,
        spp: int = 16,
        sampler: str = "larcher-pillichshammer",
        seed: int = 0,
        cull_faces: str | None = None,
        time: float = 0.0,
        progress: ProgressCallback | bool | None = None,
    ) -> Visibility:
        """The visibility of light samples from n receivers: a `Visibility` of shape (n, lights).

        `antumbra.visibility` documents the parameters. `Receivers.on_surface` and `in_space` make receivers.
        """
        checked_instance(receivers, Receivers, "receivers")
        seed = whole_number(seed, "seed", 0, 2**63 - 1)
        lights = [without_interleave(light).drawn(seed) for light in check_lights(lights, self.data.up)]
        samples, facing = [light_samples(light, spp, sampler, seed) for light in lights], cull_value(cull_faces)
        if self._few is not None and len(lights) == 1:
            found = self._few.visibility(receivers, lights[0], samples[0], facing, self._moment(time), self.threads)
            if found is not None:
                return found
        with show_progress("tracing shadow rays", progress) as callback:
            answers = self.shadows(receivers, lights, samples, facing, time, progress=callback)
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
        points = PointQuery(receivers, lights, samples, facing, self._moment(time), later, whole, month, known)
        with self.lock:
            return self._points.shadows(points, progress)

    def queries(
        self,
        receivers: Receivers,
        lights: Sequence[Light],
        samples: Sequence[NDArray[np.float64]],
        facing: int = 0,
        time: float = 0.0,
    ) -> list[ShadowQuery]:
        """The queries of `shadows`, without their bits."""
        points = PointQuery(receivers, lights, samples, facing, self._moment(time))
        with self.lock:
            return queries_in(self.source, moment_of(self.source, points.time)[0], points, self.threads)

    @property
    def prefers_rows(self) -> bool:
        """Whether points in rows of a raster are traced faster than in any other order."""
        return self._points.prefers_rows

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
        trees = self._shared.flat()
        with self.lock:
            return trees.of(self.accelerator, self._moment(time))


def chosen_plan(data: SceneData, plan: str | Plan | None, device: str | None) -> str | Plan:
    """The plan of an engine for a scene, by its options; None: not given. Raises the errors of `plan_on`."""
    with using_device(device):
        named = plan_on(device, plan, data)
        return default_plan_of(data) if named is None else named


def default_plan_of(data: SceneData) -> str:
    """The plan of an engine if none is given: on the default device, if there is one."""
    plan = plan_on(None, None, data)
    return _shared_kind(data).default_plan if plan is None else str(plan)


def _shared_kind(data: SceneData) -> type[SharedTrees]:
    """What the engines of a scene share. The store's sources load late: scenes in memory start faster without them."""
    if not data.resident:
        from .sources.paged_source import SharedStore

        return SharedStore
    return SharedInstances if data.instanced else SharedMemory
