"""Accelerators: build, optimise or update a BVH by a plan, prepare it for the plan's tracer, and answer queries.

`SceneTrees` caches the trees of a scene in memory at its latest time sample. The accelerator of the plan `auto`, in
`auto_accelerator`, also chooses what to build.
"""

import threading
from collections.abc import Callable, Sequence
from functools import partial
from typing import Any, NamedTuple, cast

import numpy as np
from numpy.typing import NDArray

from ..base.errors import InputError
from ..base.forks import is_stuck, renew_after_fork
from ..base.progress import ProgressCallback
from ..bvh.block_tree import block_tree
from ..bvh.nodes import Bvh
from ..bvh.refit import filter_tree
from ..devices.device import OutOfDeviceMemory
from ..devices.device_list import device_budget
from ..query.equal_samples import any_bit, copy_bits, with_distinct_samples
from ..query.gbuffer import GBuffer
from ..query.shadow_query import ShadowQuery, new_bits
from ..scene.camera import CameraRays
from ..scene.scene_data import MemoryData
from ..scene.triangles import Triangles
from ..techniques.chcrt.chc_rt import ChcRtState
from ..techniques.culling.pre_bvh_culling import CullRequest, CullResult, solid_of, solid_tree, soup_of
from ..techniques.srdh.representative_rays import Bounce, RepresentativeRays, RepresentativeRaySelector, SrdhRays
from ..trace.alpha_cutouts import CutoutTree, add_shadows, cutout_tree
from ..trace.rays.ray_hits import Intersections
from ..trace.tracer import TracerState
from ..trace.transmission import TracedQuery, shares_of, transmission
from .auto.strategies import AutoState, TreelessState
from .device_tracers import OnDevice, OnDeviceTracer
from .method_registry import BUILDERS, CULLERS
from .plan import Plan
from .tree_choice import ExpectedRays, LearnedTrees, OwnTree, TreeChoice, UpdatedTree, new_tree

# --- Acceleration by a plan -------------------------------------------------------------------------------------------


class Accelerated(NamedTuple):
    """A scene at one time sample with its BVH, if the plan has one."""

    triangles: Triangles  # all triangles, including culled ones
    bvh: (
        Bvh | None
    )  # over the triangles left by culling; prim_ids index `triangles`; None: the tracer has its own or none
    prepared: Any  # the tracer's input: the BVH, a structure made from it, or a `Soup` of the triangles left by culling
    cutouts: CutoutTree | None = None  # alpha-masked faces, which are not in the BVH; None: there are none
    partial: bool = False  # whether culling has dropped triangles that other queries may need
    choice: TreeChoice | None = None  # what was built, and why; None: not built by an `Accelerator`

    @property
    def host_bvh(self) -> Bvh | None:
        """The BVH on the host; one that a device has built is copied."""
        return self.prepared.host_tree if isinstance(self.prepared, OnDevice) and self.bvh is None else self.bvh

    @property
    def scheduled(self) -> ChcRtState | None:
        """The state of the tracer `chcrt`, which spans frames; None for other tracers."""
        return self.prepared if isinstance(self.prepared, ChcRtState) else None

    @property
    def chosen(self) -> AutoState | TreelessState | None:
        """The state of the tracer `auto`; None for other tracers."""
        return self.prepared if isinstance(self.prepared, (AutoState, TreelessState)) else None

    @property
    def keeps_state(self) -> bool:
        """Whether the tracer keeps state from one frame to the next."""
        return isinstance(self.prepared, TracerState)

    def begin(self) -> None:
        """Begin a new frame or point query in a tracer with state."""
        if self.keeps_state:
            self.prepared.begin()


def no_lap(step: str) -> None:
    """A `lap` of `Accelerator.tree_for` that measures nothing."""


class Accelerator:
    """Builds the input of a plan's tracer and answers queries with it.

    Parameters
    ----------
    plan : Plan
    threads : int
    memory : LearnedTrees, optional
        What earlier trees have taught, and the tree of an updater; None: nothing yet.

    Attributes
    ----------
    choice : TreeChoice
        The methods that the plan names.
    ray_selector : RepresentativeRaySelector or None
        Selects the sample rays of a ray-guided builder; None: the plan has none.
    own_tree : bool
        Whether the tracer runs the builder itself, so that there is no `Accelerated.bvh`.
    one_tree : bool
        Whether shadow rays and camera rays share a BVH.
    sees : bool
        Whether the plan's device finds what perspective cameras see: in that BVH, or without one by `draw`.
    device_memory : int or None
        Bytes that a plan on a device may allocate there; None: all that is free.
    """

    def __init__(self, plan: Plan, threads: int, memory: LearnedTrees | None = None):
        self.plan, self.threads, self.memory = plan, threads, LearnedTrees() if memory is None else memory
        self.choice = TreeChoice(plan.cull, plan.build, plan.optimise, plan.update, plan.trace, "named by the plan")
        self.ray_selector = RepresentativeRaySelector(plan.sample or SrdhRays(), threads) if plan.wants_rays else None
        self.own_tree = plan.build in plan.tracer.builders and not (plan.optimise or plan.update)
        self.one_tree = plan.tracer.builds and self.ray_selector is None
        self.sees = self.one_tree and isinstance(plan.tracer, OnDeviceTracer)
        if plan.update and self.memory.updated is None:
            self.memory.updated = UpdatedTree(plan.update)
        self.device_memory: int | None = None
        self._cutouts: tuple[Triangles, CutoutTree | None] | None = None  # the latest ones

    def begin(self, rays: int, later: int = 0, frames: int = 1) -> None:
        """Begin a frame or a point query.

        rays : estimated number of rays in the queries for which a tree is built
        later : estimated number of further rays in the same tree
        frames : estimated number of frames with as many rays in the same tree, this one included
        """
        self.memory.begin(ExpectedRays(rays, later, frames))

    @property
    def culls(self) -> bool:
        """Whether the tree of the next queries may depend on their segments, so that they must be known first."""
        return bool(self.plan.cull)

    def executed(self, accelerated: Accelerated) -> TreeChoice:
        """The methods that actually ran in a frame with this tree."""
        return self.choice

    def needs_rebuild(self, accelerated: Accelerated) -> bool:
        """Whether rebuilding a cached tree with a better builder now pays off."""
        return False

    def tree_for(
        self,
        triangles: Triangles,
        queries: Sequence[ShadowQuery],
        sample: RepresentativeRays | None = None,
        lap: Callable[[str], None] = no_lap,
    ) -> Accelerated:
        """Choose the methods for these queries, and cull and build by them. `Accelerated.choice` is the choice.

        Parameters
        ----------
        triangles : Triangles
            All triangles of the scene.
        queries : sequence of ShadowQuery
        sample : RepresentativeRays or None
            The rays for a ray-guided builder, from `sample_rays`; None: a sample of these queries.
        lap : function of str, optional
            Called with "cull" once triangles have been culled.
        """
        culled: CullResult | None = None
        if self.plan.cull:
            culler = CULLERS[self.plan.cull]
            if self.own_tree and culler.cells is not None:
                request = CullRequest(queries, culler.cells, self.threads, lap)
                return self.prepare(self.choice, triangles, None, None, request)
            culled = culler.cull(triangles, queries, self.threads)
            lap("cull")
        if sample is None:
            sample = self.sample_rays(triangles, queries)
        return self.execute(self.choice, triangles, culled, sample)

    def build(self, triangles: Triangles, sample: RepresentativeRays | None = None) -> Accelerated:
        """Prepare all triangles for tracing queries that are not known yet; `sample`: for a ray-guided builder.

        Raises
        ------
        InputError
            If the builder is ray-guided and `sample` is None.
        """
        return self.execute(self.choice, triangles, None, sample)._replace(partial=False)

    def sample_rays(
        self,
        triangles: Triangles,
        queries: Sequence[ShadowQuery],
        bvh: Bvh | None = None,
        bounce: Bounce | None = None,
    ) -> RepresentativeRays | None:
        """Sample rays of these queries for a ray-guided builder; None for others. See `RepresentativeRaySelector`."""
        return self.ray_selector.show(queries, triangles, bvh, bounce) if self.ray_selector else None

    def execute(
        self,
        choice: TreeChoice,
        triangles: Triangles,
        culled: CullResult | None = None,
        sample: RepresentativeRays | None = None,
    ) -> Accelerated:
        """Prepare all or the unculled triangles for tracing by a choice; build a BVH unless the tracer uses none.

        Parameters
        ----------
        choice : TreeChoice
        triangles : Triangles
            All triangles of the scene.
        culled : CullResult or None
            The triangles left by culling; None: all.
        sample : RepresentativeRays or None
            Rays for a ray-guided builder.

        Raises
        ------
        InputError
            If the builder is ray-guided and `sample` is None.
        """
        if self.own_tree and culled is None:
            return self.prepare(choice, triangles, None)
        solid = solid_of(triangles, culled, self.threads)
        if choice.builder is None or self.own_tree:
            return self.prepare(choice, triangles, None, solid)
        if self.ray_selector is not None and sample is None:
            raise InputError(f"plan {str(self.plan)!r}: its builder needs sample rays; render an image or query points")
        bvh = self._tree(choice, triangles, solid, sample)
        if culled is not None and solid is not None and choice.updater:
            bvh = filter_tree(bvh, solid.kept, self.threads)
        if self.ray_selector is not None:
            self.ray_selector.built(bvh)
        return self.prepare(choice, triangles, bvh, solid)

    def _tree(
        self, choice: TreeChoice, triangles: Triangles, solid: CullResult | None, sample: RepresentativeRays | None
    ) -> Bvh:
        """The BVH of these triangles; an updater's has all solid ones.

        solid : the solid triangles, or those that culling left; None: all triangles
        """
        ids, rays = triangles.solid if solid is None or choice.updater else solid.kept, None
        if sample is not None:
            rays = partial(_meetings, sample, ids, self.threads)
        if choice.updater:
            assert self.memory.updated is not None
            return self.memory.updated.at(triangles, self.threads, choice, rays)
        if solid is None:
            return new_tree(choice, triangles.vertices, self.threads, rays)
        bvh = new_tree(choice, solid.vertices, self.threads, rays)
        return bvh._replace(prim_ids=solid.kept[bvh.prim_ids])

    def prepare_all(self, triangles: Triangles) -> Accelerated | None:
        """All triangles, prepared for camera rays: in the plan's BVH or a separate one; None: a device has no room."""
        if not self.one_tree:
            return self.for_camera(triangles)
        try:
            return self.build(triangles)
        except OutOfDeviceMemory:
            return None

    def draw(self, triangles: Triangles, rays: CameraRays) -> GBuffer | None:
        """What a perspective camera sees, drawn without a tree on the plan's device; None: the CPU must draw it."""
        if not self.sees:
            return None
        tracer = cast(OnDeviceTracer, self.plan.tracer)
        with device_budget(self.device_memory):
            return tracer.draw(triangles, rays, self.cutouts_of(triangles), self.threads)

    def for_camera(self, triangles: Triangles) -> Accelerated:
        """A `bsah` BVH for camera rays, for plans without a BVH or with one specialised to shadow rays."""
        bvh = solid_tree(BUILDERS["bsah"].build, triangles, self.threads)
        return Accelerated(triangles, bvh, block_tree(bvh, self.threads), self.cutouts_of(triangles))

    def cutouts_of(self, triangles: Triangles) -> CutoutTree | None:
        """The tree of alpha-masked faces; None if there are none. The latest tree is cached."""
        if self._cutouts is None or self._cutouts[0] is not triangles:
            self._cutouts = triangles, cutout_tree(triangles, self.threads)
        return self._cutouts[1]

    def prepare(
        self,
        choice: TreeChoice,
        triangles: Triangles,
        bvh: Bvh | None,
        solid: CullResult | None = None,
        request: CullRequest | None = None,
    ) -> Accelerated:
        """Convert the BVH to the input of this plan's tracer; without one, the triangles, or a tree that it builds.

        solid : the solid triangles, or those that culling left; None: all
        request : how the tracer culls before it builds a tree
        """
        tracer, updated = self.plan.tracer, self.memory.updated
        with device_budget(self.device_memory):
            if bvh is None and choice.builder is not None:
                faces = triangles.solid if solid is None else solid.kept
                prepared = self._own_tree(choice.builder, triangles, faces, request)
            else:
                geometry = soup_of(triangles, solid, self.threads) if bvh is None else bvh
                prepared = tracer.prepare(geometry, self.threads)
        if updated is not None and isinstance(prepared, ChcRtState):
            if updated.state is not None:
                prepared.continue_from(updated.state)
            updated.state = prepared
        return Accelerated(triangles, bvh, prepared, self.cutouts_of(triangles), bool(choice.culler), choice)

    def _own_tree(
        self, builder: str, triangles: Triangles, faces: NDArray[np.int32] | None, request: CullRequest | None
    ) -> Any:
        """A tree from the tracer: the latest one, refitted, or a new one."""
        tracer = self.plan.tracer
        if request is not None:
            return tracer.build(builder, triangles, faces, request)
        latest, self.memory.own = self.memory.own, None
        prepared = None if latest is None else latest.at(tracer, triangles, faces)
        if prepared is None:
            latest = None  # on a device, there may be no room for both
            prepared = tracer.build(builder, triangles, faces)
        self.memory.own = OwnTree(triangles, faces, prepared)
        return prepared

    def answer(
        self,
        accelerated: Accelerated,
        query: ShadowQuery,
        tally: np.ndarray | None = None,
        progress: ProgressCallback | None = None,
    ) -> NDArray[np.uint64]:
        """Trace a query with this plan's tracer: (h, w, ceil(spp / 64)) uint64; bit s = sample s is occluded."""
        return self.answer_all(accelerated, [query], tally, progress)[0]

    def answer_all(
        self,
        accelerated: Accelerated,
        queries: Sequence[ShadowQuery],
        tally: np.ndarray | None = None,
        progress: ProgressCallback | None = None,
        known: Sequence[NDArray[np.uint64]] | None = None,
    ) -> list[NDArray[np.uint64]]:
        """Trace several queries whose receivers have the same shape. Returns the bits of each, as from `answer`.

        Equal samples of a receiver are traced once, and its bit is copied; `tally` counts the rays that are traced.

        known : as for `Engine.shadows`
        """
        traced = [with_distinct_samples(query) for query in queries]
        bits = [new_bits(query) for query in traced]
        for words, blocked, few, query in zip(bits, () if known is None else known, traced, queries):
            words[...] = blocked if few is query else any_bit(blocked)
        trace = self.plan.tracer.trace_all
        trace(accelerated.prepared, traced, bits, self.threads, tally, progress, known is None)
        if accelerated.cutouts is not None:
            prepared = accelerated.prepared
            add = prepared.add_shadows if isinstance(prepared, OnDevice) else add_shadows
            for few, words in zip(traced, bits):
                add(accelerated.cutouts, few, words, self.threads)
        return [
            words if few is query else copy_bits(words, query.samples.shape[1])
            for words, few, query in zip(bits, traced, queries)
        ]

    def traced_query(self, accelerated: Accelerated, query: ShadowQuery, bits: NDArray[np.uint64]) -> TracedQuery:
        """A query with its bits, and with the light that comes through cut-outs."""
        prepared = accelerated.prepared
        shares = prepared.shares if isinstance(prepared, OnDevice) else shares_of
        return TracedQuery(query, bits, transmission(accelerated.cutouts, query, bits, self.threads, shares))


def _meetings(
    sample: RepresentativeRays,
    ids: NDArray[np.int32] | None,
    threads: int,
    vertices: NDArray[np.float32],
    bvh: Bvh | None,
) -> Intersections:
    """What sample rays meet among the triangles `ids`; None: all."""
    return sample.among(vertices, ids, threads, bvh)


# --- The cached triangles and trees of a scene in memory --------------------------------------------------------------


def _shares(accelerated: Accelerated) -> bool:
    """Whether another tracer can take the tree, or the triangles: it is not one that a tracer has built itself."""
    return accelerated.bvh is not None or accelerated.choice is None or accelerated.choice.builder is None


class SceneTrees:
    """The latest triangles of a scene and a tree per plan, shared by the engines of the scene. It is thread-safe.

    Triangles change with the time of an animation, or when `MemoryData.update` moves them.

    data : MemoryData
    """

    def __init__(self, data: MemoryData):
        self.data, self._lock = data, threading.RLock()
        self.clear()
        renew_after_fork(self)

    def clear(self) -> None:
        """Drop the triangles and all trees. Other threads must not use them meanwhile."""
        self._time: float | None = None
        self._triangles: Triangles | None = None
        self._accelerated: dict[Plan, Accelerated] = {}

    def _after_fork(self) -> None:
        if is_stuck(self._lock):
            self._lock = threading.RLock()
            self.clear()

    def triangles(self, time: float, threads: int) -> Triangles:
        """The triangles at a time within 0 .. `duration`. Those of the latest time are cached."""
        with self._lock:
            if self._triangles is None or not self._is_current(time):
                self.clear()  # first: there may be no memory for both, and a time that fails has no triangles
                self._triangles = self.data.triangles(time, threads)
                self._time = time
            return self._triangles

    def _is_current(self, time: float) -> bool:
        """Whether the cached triangles are those of this time, and no update has moved them."""
        moved = self.data.moved
        return time == self._time and (moved is None or moved is self._triangles)

    def of(self, accelerator: Accelerator, time: float) -> Accelerated:
        """The tree of a plan at a time within 0 .. `duration`. Plans that differ only in their tracer share a BVH."""
        with self._lock:
            triangles, plan = self.triangles(time, accelerator.threads), accelerator.plan
            accelerated = self._accelerated.get(plan)
            if accelerated is None or accelerator.needs_rebuild(accelerated):
                sibling = (
                    None
                    if plan.chooses
                    else next((t for p, t in self._accelerated.items() if p.tree == plan.tree and _shares(t)), None)
                )
                accelerated = (
                    accelerator.build(triangles)
                    if sibling is None
                    else accelerator.prepare(accelerator.choice, triangles, sibling.bvh)
                )
                self._accelerated[plan] = accelerated
            return accelerated

    def cached(self, accelerator: Accelerator, time: float) -> Accelerated | None:
        """The tree of a plan at a time, as from `of`; None if it is not there or must be rebuilt."""
        with self._lock:
            accelerated = self._accelerated.get(accelerator.plan) if self._is_current(time) else None
            return None if accelerated is None or accelerator.needs_rebuild(accelerated) else accelerated

    def add(self, plan: Plan, accelerated: Accelerated) -> None:
        """Cache the tree of a plan, unless the triangles have changed since it was built."""
        with self._lock:
            if accelerated.triangles is self._triangles:
                self._accelerated[plan] = accelerated

    def evict(self, plan: Plan) -> None:
        """Drop the tree of this plan."""
        with self._lock:
            self._accelerated.pop(plan, None)
