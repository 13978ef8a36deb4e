"""Scenes in memory: all triangles are resident, and any plan can trace them.

Ray lists begin with a GOOD tree at each time sample. It is replaced by a BEST one once the rays have lost as much time
as that rebuild costs (the ski-rental rule), so the total loss is at most twice the minimum, however many rays follow.
`AutoAccelerator` applies the same rule to images. When users move the geometry, the tree is refitted, and
`refitted_rays` decides by the same rule when to start again with a GOOD one.
"""

import threading
from time import perf_counter
from typing import ClassVar, NamedTuple, cast

import numpy as np
from numpy.typing import NDArray

from ...base.errors import InputError
from ...base.forks import is_stuck, renew_after_fork
from ...query.closed_surfaces import closed_surfaces
from ...query.pixel_refinement import subpixel_rays
from ...query.query_bounds import triangle_box
from ...query.ray_list import RayArguments, TracedRays, hit_arrays
from ...query.shadow_query import Surfaces, surfaces_of
from ...query.surface_caps import surface_caps
from ...scene.scene_data import MemoryData, SceneData
from ...scene.triangle_setup import met_by_rays, rows_with_area, solid_faces
from ...scene.triangles import AllHits, ClosestPoints, Triangles
from ...trace.alpha_cutouts import CutoutTree
from ...trace.closest_points import closer_of, closest_points
from ...trace.rays.all_hits import (
    APART,
    INSIDE,
    POINTS,
    UNCLEAR,
    RayHits,
    count_all,
    find_all,
    merge_triangles,
    unsigned,
)
from ...trace.rays.cell_verdicts import CellVerdicts
from ...trace.rays.inside_votes import Caps
from ...trace.rays.ray_batches import RayTracer
from ..accelerator import Accelerated, Accelerator, SceneTrees
from ..auto.cost_model import BEST, GOOD, seconds_before_best
from ..device_tracers import device_tracer, free_blocks
from ..plan import DEFAULT_PLAN, Plan, parse_plan
from ..precompilation import precompile
from ..primary_visibility import (
    AUTO,
    RASTER,
    RAYS,
    PrimaryMethodChooser,
    nearest_in,
    primary_visibility,
    subpixel_visibility,
)
from ..refitted_rays import RayTreeRefit
from .cutout_hits import CutoutHits, of_valid
from .source_protocols import Bodies, CameraView, SourceSettings

# --- Ray lists --------------------------------------------------------------------------------------------------------


RAY_PLANS = f"{GOOD}+wide", f"{BEST}+wide"
"""The plan of the first rays at a time sample, and that of later ones."""


class _RayTree(NamedTuple):
    """The tree of a time sample."""

    time: float
    drawn: Triangles  # of which `accelerated` has those that rays meet
    plan: Plan
    upgrade_after: float  # seconds of tracing after which a better tree pays off
    accelerated: Accelerated
    tracer: RayTracer


class RayLists:
    """Traces the ray lists of a scene in memory, a `RayListSource`. It is thread-safe.

    spent : float
        Seconds of all threads, spent on rays since the latest GOOD tree was built.
    """

    def __init__(self, data: MemoryData, trees: SceneTrees, threads: int):
        self._data, self._trees, self._threads = data, trees, threads
        self._ready: _RayTree | None = None
        self._cutouts: CutoutHits | None = None  # of the latest cut-outs
        self._bodies: tuple[Triangles, Bodies] | None = None  # of the latest triangles for which they were needed
        self._refit = RayTreeRefit(threads)
        self._lock = threading.RLock()
        self.spent = 0.0
        renew_after_fork(self)

    def _after_fork(self) -> None:
        if is_stuck(self._lock):  # the tree that was being built is not in `_ready` yet
            self._lock = threading.RLock()

    def trace_rays(self, rays: RayArguments, any_hit: bool, threads: int) -> TracedRays:
        """The hits of rays. InputError if a ray is invalid."""
        n = rays.n
        ready = self._ready_at(rays.time, n)
        out, start = hit_arrays(n, any_hit), perf_counter()
        valid = ready.tracer.trace(rays, any_hit, out, threads)
        self._count(start, threads)
        if not valid:
            of_valid(rays, None)
        cutouts = ready.accelerated.cutouts
        if cutouts is not None:
            self._hits_of(cutouts).add(rays, any_hit, out, threads)
        if any_hit:
            return TracedRays(out, None)
        triangles, shape = ready.accelerated.triangles, rays.shape
        return TracedRays(out, lambda: (triangles, out.face.reshape(shape)))

    def _count(self, start: float, threads: int) -> None:
        """Count the computing time of rays, traced since `start`."""
        seconds = (perf_counter() - start) * threads
        self.spent += seconds
        self._refit.add(seconds)

    def all_hits(self, rays: RayArguments, max_hits: int | None, rule: int, threads: int) -> AllHits:
        """All hits of rays, or the first `max_hits` of each; `rule`: TRIANGLES or SURFACES."""
        precompile("all hits")
        ready, start = self._ready_at(rays.time, rays.n), perf_counter()
        hits = of_valid(rays, find_all(ready.tracer, rays, max_hits, rule, threads))
        self._count(start, threads)
        cutouts = ready.accelerated.cutouts
        if cutouts is None:
            return unsigned(hits)
        on_cutouts = self._hits_of(cutouts).all_hits(rays, rule, threads)
        every_ray = np.arange(rays.n)
        return merge_triangles([RayHits(every_ray, hits), RayHits(every_ray, on_cutouts)], rays.n, max_hits)

    def count_hits(self, rays: RayArguments, rule: int, threads: int) -> NDArray[np.int64]:
        """(n,) int64: the number of hits of each ray, by a rule of `trace.rays.all_hits`. INSIDE sees no holes."""
        precompile("all hits")
        ready, start = self._ready_at(rays.time, rays.n), perf_counter()
        counts = of_valid(rays, count_all(ready.tracer, rays, rule, threads))
        self._count(start, threads)
        cutouts = ready.accelerated.cutouts
        if cutouts is None:
            return counts
        if rule in (POINTS, APART):
            return np.full(rays.n, UNCLEAR)
        return counts + self._hits_of(cutouts).count_hits(rays, rule, threads)

    def count_points(self, rays: RayArguments, apart: bool, threads: int) -> NDArray[np.int64]:
        """(n,) int64: the number of distinct t of each ray's hits; -1: unknown, which takes `all_hits`.

        apart : whether it is unknown where two may be equal
        """
        counts = self.count_hits(rays, APART if apart else POINTS, threads)
        counts[counts >= UNCLEAR] = -1
        return counts

    def bodies(self, time: float) -> Bodies:
        """The surfaces at a time within 0 .. `duration`, cached for the latest one; those drawn twice count once."""
        triangles = self.triangles(time)
        with self._lock:
            if self._bodies is None or self._bodies[0] is not triangles:
                self._bodies = triangles, self._bodies_of(triangles, time)
            bodies = self._bodies[1]
            return bodies if bodies.time == time else bodies._replace(time=time)

    def _bodies_of(self, triangles: Triangles, time: float) -> Bodies:
        precompile("ray queries")
        precompile("contains")
        vertices, cutouts = triangles.vertices, triangles.cutouts
        shown = None if cutouts is None else np.union1d(cutouts.solid, cutouts.faces)
        open_edges, once = closed_surfaces(vertices if shown is None else vertices[shown])
        box = triangle_box(triangles, self._threads)
        axis = np.eye(3)[np.argmin(box[1] - box[0])]  # along which rays meet the fewest faces
        bodies = Bodies(box, open_edges, self._count_insides, time, axis)
        kept = once if shown is None or once is None else shown[once]
        if once is not None:
            tracer = self._tracer_of(triangles._replace(solid=kept))
            count = lambda rays, threads: of_valid(rays, count_all(tracer, rays, INSIDE, threads))
            bodies = bodies._replace(crossings=count)
        if open_edges:
            drawn = shown if kept is None else kept
            corners = surface_caps(vertices if drawn is None else vertices[drawn])
            if corners is not None:
                above = corners.reshape(-1, 3).mean(axis=0) @ axis > box.mean(axis=0) @ axis
                away = -axis if above else axis
                bodies = bodies._replace(along=away, caps=self._caps_of(corners, triangles.origin, away, box))
        if open_edges and bodies.caps is None:
            return bodies
        along = axis if bodies.along is None else bodies.along
        return bodies._replace(cells=CellVerdicts(vertices, box, bodies.crossings, along, bodies.caps))

    def _caps_of(
        self,
        corners: NDArray[np.float32],
        origin: NDArray[np.float64],
        along: NDArray[np.float64],
        box: NDArray[np.float32],
    ) -> Caps:
        """Caps, from their (n, 3, 3) corners.

        along : (3,), of the first rays
        box : (2, 3), bounds of the scene
        """
        n = len(corners)
        caps = Triangles(corners, origin, np.arange(n, dtype=np.int32), np.ones((n, 3), np.float32))
        return Caps(self._tracer_of(caps), corners, along, box)

    def _count_insides(self, rays: RayArguments, threads: int) -> NDArray[np.int64]:
        return self.count_hits(rays, INSIDE, threads)

    def _tracer_of(self, triangles: Triangles) -> RayTracer:
        """A tracer of the triangles with area, among the `solid` ones."""
        solid = solid_faces(rows_with_area(triangles.vertices, self._threads), triangles.solid)
        accelerator = Accelerator(parse_plan(RAY_PLANS[0]), self._threads)
        return RayTracer(accelerator.build(triangles._replace(solid=solid, cutouts=None)).prepared)

    def closest_points(self, points: NDArray[np.float32], time: float, threads: int) -> ClosestPoints:
        """The closest points to points, (n, 3) in the scene's frame, at a time; those of cut-outs may lie in holes."""
        precompile("closest points")
        ready, start = self._ready_at(time, len(points)), perf_counter()
        closest = closest_points(ready.tracer.tree, points, threads)
        self._count(start, threads)
        cutouts = ready.accelerated.cutouts
        if cutouts is None:
            return closest
        return closer_of(closest, self._hits_of(cutouts).closest_points(points, threads))

    def _hits_of(self, cutouts: CutoutTree) -> CutoutHits:
        """The tracer of the cut-outs, which is cached."""
        cached = self._cutouts
        if cached is None or cached.tree is not cutouts:
            cached = self._cutouts = CutoutHits(cutouts, self._threads)
        return cached

    @property
    def plan(self) -> Plan | None:
        """The plan of the latest rays."""
        return None if self._ready is None else self._ready.plan

    def triangles(self, time: float) -> Triangles:
        """The triangles at a time within 0 .. `duration`."""
        return self._trees.triangles(time, self._threads)

    def _ready_at(self, time: float, queries: int) -> _RayTree:
        """The tree for a number of rays or points at a time."""
        ready = self._ready
        if ready is None or not self._is_current(ready, time):
            return self._make_ready(time, queries)
        return ready if self.spent <= ready.upgrade_after else self._upgraded(ready, queries)

    def triangles_of_tree(self, time: float) -> Triangles | None:
        """The triangles at a time within 0 .. `duration` if there is a tree of them."""
        ready = self._ready
        return ready.drawn if ready is not None and self._is_current(ready, time) else None

    def _upgraded(self, ready: _RayTree, rays: int) -> _RayTree:
        """The better tree; or this one while another thread builds the better one, so that only one call waits."""
        if not self._lock.acquire(blocking=False):
            return ready
        try:
            return self._make_ready(ready.time, rays)
        finally:
            self._lock.release()

    def _is_current(self, ready: _RayTree, time: float) -> bool:
        """Whether a tree is of this time, and no update has moved its triangles."""
        moved = self._data.moved
        return ready.time == time and (moved is None or moved is ready.drawn)

    def _make_ready(self, time: float, rays: int) -> _RayTree:
        with self._lock:
            ready = self._ready
            begins = ready is None or ready.time != time
            if ready is not None and not (begins or self._is_current(ready, time) or self.spent > ready.upgrade_after):
                refitted = self._refitted(ready, rays)
                if refitted is not None:
                    self._ready = refitted
                    return refitted
                begins = True
            if ready is None or begins:
                precompile("ray queries")
                self.spent, plan = 0.0, parse_plan(RAY_PLANS[0])
            elif self.spent > ready.upgrade_after:
                precompile("best tree")
                self._trees.evict(ready.plan)
                plan = parse_plan(RAY_PLANS[1])
            else:  # another thread has built it
                return ready
            accelerator, drawn = Accelerator(plan, self._threads), self.triangles(time)
            met = met_by_rays(drawn, self._threads)
            accelerated = self._trees.of(accelerator, time) if met is drawn else accelerator.build(met)
            upgrade_after = seconds_before_best(self._data.n_triangles) if str(plan) == RAY_PLANS[0] else np.inf
            self._ready = _RayTree(time, drawn, plan, upgrade_after, accelerated, RayTracer(accelerated.prepared))
            self._refit.begin()
            return self._ready

    def _refitted(self, ready: _RayTree, rays: int) -> _RayTree | None:
        """The tree with the triangles of the latest update; None if another one must be built."""
        accelerator = Accelerator(ready.plan, self._threads)
        drawn = self.triangles(ready.time)
        met = met_by_rays(drawn, self._threads)
        accelerated = self._refit.refit(accelerator, ready.accelerated, met, rays)
        if accelerated is None:
            return None
        self._trees.add(ready.plan, accelerated)
        return ready._replace(drawn=drawn, accelerated=accelerated, tracer=RayTracer(accelerated.prepared))


# --- Scenes in memory -------------------------------------------------------------------------------------------------


class InMemory:
    """A scene whose triangles are in memory: a `RenderSource` with `Geometry`.

    Parameters
    ----------
    data : MemoryData
    accelerator : Accelerator
        Holds the plan and builds its trees.
    trees : SceneTrees
        Shared with other engines of the scene.
    gbuffer : "raster", "rays" or "auto"
        The method of primary visibility; "auto": the faster one, see `primary_visibility`; on a device, rays through a
        tree that an earlier frame has cached, otherwise rasterisation. "raster" rasterises on the CPU.

    Attributes
    ----------
    ray_lists : RayLists
        Traces ray lists, through a tree of its own.
    """

    default_plan: ClassVar[str] = DEFAULT_PLAN
    looks: ClassVar[int] = 0
    fixed = memory = None

    def __init__(self, data: MemoryData, accelerator: Accelerator, trees: SceneTrees, gbuffer: str = AUTO):
        self.scene, self._method_chooser, self._trees = data, PrimaryMethodChooser(), trees
        self.gbuffer = gbuffer
        self._accelerator, self.threads = accelerator, accelerator.threads
        self._box: tuple[Triangles, np.ndarray] | None = None  # the latest triangles and their bounds
        self.ray_lists = RayLists(data, trees, self.threads)
        self._last: Accelerated | None = None  # the tree of earlier frames, if later frames can reuse it

    @property
    def geometry(self) -> "InMemory":
        return self

    def warm_up(self) -> None:
        if self.scene.cutouts is not None:
            precompile("cut-outs")

    def moment(self, time: float) -> tuple[Triangles, Accelerated | None]:
        triangles, last = self._trees.triangles(time, self.threads), self._last
        if last is None or last.triangles is not triangles or self._accelerator.needs_rebuild(last):
            self._last = None
            return triangles, None
        return triangles, last

    def for_points(self, time: float) -> tuple[Triangles, Accelerated | None]:
        plan = self._accelerator.plan
        if plan.cull or plan.wants_rays:
            return self._trees.triangles(time, self.threads), None
        if self._accelerator.culls:
            cached = self._trees.cached(self._accelerator, time)
            return (self._trees.triangles(time, self.threads), None) if cached is None else (cached.triangles, cached)
        ready = self._trees.of(self._accelerator, time)
        return ready.triangles, ready

    def triangles_for_few(self, time: float) -> Triangles | None:
        triangles = self.ray_lists.triangles_of_tree(time)
        if triangles is None and self._trees.cached(self._accelerator, time) is None:
            triangles = self._trees.triangles(time, self.threads)  # otherwise rays would need a second tree
        return None if triangles is None or triangles.cutouts is not None else triangles

    def keep_for_points(self, accelerated: Accelerated) -> None:
        if not (accelerated.partial or self._accelerator.plan.wants_rays):
            self._trees.add(self._accelerator.plan, accelerated)

    def keep(self, accelerated: Accelerated | None) -> None:
        """Cache the tree if later frames use the same triangles and tree, whoever chose the plan; None: drop it.

        Not a tree that is built for the rays of its frame.
        """
        if accelerated is None:
            self._last = None
        elif not (self.scene.animated or accelerated.partial or self._accelerator.plan.wants_rays):
            self._last = accelerated

    def box(self, triangles: Triangles) -> np.ndarray:
        if self._box is None or self._box[0] is not triangles:
            self._box = triangles, triangle_box(triangles, self.threads)
        return self._box[1]

    def look(self, view: CameraView) -> Surfaces:
        """The surfaces visible to a camera, always in all rows."""
        camera, cutouts = view.camera, self._accelerator.cutouts_of(view.triangles)

        def surfaces(by_rays: bool) -> Surfaces:
            tree = view.tree if by_rays else None
            draw = self._accelerator.draw if self.gbuffer == AUTO else None
            seen = primary_visibility(view.triangles, camera, tree, self.threads, cutouts, draw)
            return surfaces_of(seen, view.triangles)

        if camera.listed or self.gbuffer != AUTO:
            return surfaces(camera.listed or self.gbuffer == RAYS)
        if self._accelerator.sees:
            return surfaces(True)
        method = self._method_chooser.choose(view.tree)
        return self._method_chooser.timed(method, camera.width * camera.height, lambda: surfaces(method == RAYS))

    def see_on_cpu(self) -> bool:
        accelerator = self._accelerator
        if not accelerator.sees or self.gbuffer == RASTER:
            return False
        self.gbuffer = RASTER
        if accelerator.plan.cull:
            self._last = accelerator.memory.own = None  # the tree of the camera
        free_blocks(device_tracer(str(accelerator.plan.device), accelerator.device_memory))
        return True

    def subpixels(self, view: CameraView, edge: NDArray[np.bool_]) -> Surfaces:
        triangles = view.triangles
        if view.camera.listed:
            assert view.tree is not None
            rays, shape = subpixel_rays(view.camera.view(triangles.origin), edge, self.threads)
            return next(nearest_in(view.tree, self.threads)([rays], shape))
        camera_rays, cutouts = view.camera.rays(triangles.origin), self._accelerator.cutouts_of(triangles)
        return surfaces_of(subpixel_visibility(triangles, camera_rays, edge, self.threads, cutouts), triangles)


class SharedMemory:
    """The triangles and trees of a scene in memory, shared by its engines: `SharedTrees`."""

    default_plan: ClassVar[str] = InMemory.default_plan

    def __init__(self, data: SceneData):
        self._data = cast(MemoryData, data)
        self._trees = SceneTrees(self._data)

    def source(self, accelerator: Accelerator, settings: SourceSettings) -> InMemory:
        """The source of an engine. InputError for a limit on memory, unless the plan traces on a device."""
        limit_device(self._data, accelerator, settings)
        return InMemory(self._data, accelerator, self._trees, settings.gbuffer)

    def flat(self) -> SceneTrees:
        return self._trees

    def clear(self) -> None:
        self._trees.clear()


def limit_device(data: SceneData, accelerator: Accelerator, settings: SourceSettings) -> None:
    """Limit the memory of the device on which a plan traces. InputError for a limit in memory without a device."""
    if settings.max_memory is not None and accelerator.plan.device is None:
        raise InputError(f"max_memory is for scenes in a store, and {data.name} is in memory; leave it out")
    accelerator.device_memory = settings.max_memory
