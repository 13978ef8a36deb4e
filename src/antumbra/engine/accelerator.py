"""Accelerators: build, optimise or update a BVH by a plan, prepare it for the plan's tracer, and answer queries.

The accelerator of the plan `auto` chooses the builder of each frame's tree. Scenes in memory cache the trees of their
latest time sample.
"""

import threading
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from typing import Any, NamedTuple

import numpy as np

from ..auto.choose import Memory, suited_ways
from ..auto.facts import facts_of
from ..auto.rates import BEST, GOOD, QUICK, best_pays, good_pays, lost_share, rate
from ..auto.trace import Auto
from ..bvh.blocks import block_tree
from ..bvh.kept import part_of
from ..bvh.nodes import Bvh
from ..bvh.srdh_rays import SrdhRays
from ..errors import InputError
from ..methods import BUILDERS, CULLERS, OPTIMISERS, TRACERS, UPDATERS
from ..plan import Plan, parse_plan
from ..query.query_bounds import bounds
from ..query.shadow_query import ShadowQuery, new_bits
from ..scene.memory import MemoryData
from ..scene.triangles import Triangles
from ..techniques.chcrt.chc_rt import ChcRtState
from ..techniques.culling.pre_bvh_culling import CullResult, solid_count, solid_of, solid_tree, soup_of
from ..techniques.srdh.representative_rays import Bounce, RepresentativeRays, RepresentativeRaySelector
from ..trace.alpha_test import CutoutTree, add_shadows, cutout_tree
from .precompilation import Job, fixed_job, precompile, small_scene

# ---------------------------------------------------------------------------------------------------------------------
# Acceleration by a plan: build, optimise or update a BVH, prepare it for the plan's tracer, and answer queries.


class Accelerated(NamedTuple):
    """A scene at one moment with its BVH, if the plan has one."""

    triangles: Triangles  # all triangles, including culled ones
    bvh: Bvh | None  # over the triangles left by culling; prim_ids index `triangles`; None: the tracer walks no BVH
    prepared: Any  # the tracer's input: the BVH, a structure made from it, or a `Soup` of the triangles left
    cutouts: CutoutTree | None = None  # faces with holes, which are not in the BVH; None: there are none

    @property
    def scheduled(self) -> ChcRtState | None:
        """The state of a tracer that remembers earlier frames; None for other tracers."""
        return self.prepared if isinstance(self.prepared, ChcRtState) else None

    @property
    def chosen(self) -> Auto | None:
        """The state of the tracer `auto`; None for other tracers."""
        return self.prepared if isinstance(self.prepared, Auto) else None

    def begin(self) -> None:
        """Tell the tracer that a new frame, or a new query of points, begins."""
        if isinstance(self.prepared, (ChcRtState, Auto)):
            self.prepared.begin()


class Accelerator:
    """Builds the structure that a plan's tracer takes, and answers queries with it; keeps the state of updaters.

    Parameters
    ----------
    plan : Plan
    threads : int
    """

    def __init__(self, plan: Plan, threads: int):
        self.plan, self.threads = plan, threads
        self.showing = RepresentativeRaySelector(plan.sample or SrdhRays(), threads) if plan.wants_rays else None
        self.one_tree = plan.tracer.builds and self.showing is None  # one BVH for shadow rays and camera rays
        self._kept = UPDATERS[plan.update].keep(self._new_tree) if plan.update else None
        self._updated: tuple[Triangles, Bvh] | None = None  # all triangles that the updater saw last, and their BVH
        self._cutouts: tuple[Triangles, CutoutTree | None] | None = None  # those asked for last
        self._rays: Callable | None = None  # (vertices, their BVH) -> Intersections; set while a builder runs

    def begin(self, rays: int, later: int = 0) -> None:
        """Begin a frame, or a query of points.

        rays, later : about so many rays in the queries for which a tree is built, and others in the same tree
        """

    @property
    def builder(self) -> str:
        """The name of the builder of the next tree."""
        assert self.plan.build is not None
        return self.plan.build

    @property
    def optimiser(self) -> str | None:
        """The name of the optimiser of the next tree; None: it stays as it was built."""
        return self.plan.optimise

    def ran(self, accelerated: Accelerated) -> Plan:
        """The plan with the methods of a frame that used this tree."""
        return self.plan

    def outgrown(self, accelerated: Accelerated) -> bool:
        """Should a tree that was kept be built again, by a better builder?"""
        return False

    def culled(self, triangles: Triangles, queries) -> CullResult | None:
        """The triangles that segments of these queries can meet; None if the plan has no culler."""
        return CULLERS[self.plan.cull].cull(triangles, queries, self.threads) if self.plan.cull else None

    def show(
        self, triangles: Triangles, queries, bvh: Bvh | None = None, bounce: Bounce | None = None
    ) -> RepresentativeRays | None:
        """The rays to show to this plan's builder for these queries; None if it takes none. See `Showing.show`."""
        return self.showing.show(queries, triangles, bvh, bounce) if self.showing else None

    def build(
        self, triangles: Triangles, culled: CullResult | None = None, sample_rays: RepresentativeRays | None = None
    ) -> Accelerated:
        """Prepare all triangles, or the culled set, for tracing; build a BVH unless the tracer walks none.

        Parameters
        ----------
        triangles : Triangles
            All triangles of the scene.
        culled : Culled or None
            The triangles left by culling; None: all.
        shown : Shown or None
            Rays for a ray-guided builder.

        Raises
        ------
        InputError
            If the builder is ray-guided and `shown` is None.
        """
        solid = solid_of(triangles, culled, self.threads)
        if not self.plan.tracer.builds:
            return self.prepare(triangles, None, solid)
        if self.showing is not None:
            if sample_rays is None:
                raise InputError(f"plan {str(self.plan)!r}: its builder wants rays of a picture, or of points that ask")
            indices = triangles.solid if solid is None or self._kept is not None else solid.kept
            self._rays = lambda vertices, bvh: sample_rays.among(vertices, indices, self.threads, bvh)
        try:
            bvh = self._updated_tree(triangles, culled) if self._kept is not None else self._tree(triangles, solid)
        finally:
            self._rays = None
        if self.showing is not None:
            self.showing.built(bvh)
        return self.prepare(triangles, bvh, solid)

    def _tree(self, triangles: Triangles, culled: CullResult | None) -> Bvh:
        """A new BVH of all triangles, or of those that are left."""
        if culled is None:
            return self._new_tree(triangles.vertices, self.threads)
        bvh = self._new_tree(culled.vertices, self.threads)
        return bvh._replace(prim_ids=culled.kept[bvh.prim_ids])

    def _updated_tree(self, triangles: Triangles, culled: CullResult | None) -> Bvh:
        """The BVH of the solid triangles that the updater keeps, or its part with those that culling left."""
        assert self._kept is not None
        if self._updated is None or self._updated[0] is not triangles:  # else a frame asks once more
            self._updated = triangles, solid_tree(self._kept.update, triangles, self.threads)
        bvh = self._updated[1]
        solid = solid_of(triangles, culled, self.threads) if culled is not None else None
        return bvh if solid is None else part_of(bvh, solid.kept, self.threads)

    def _new_tree(self, vertices, threads) -> Bvh:
        builder, name = BUILDERS[self.builder], self.optimiser
        bvh = builder.build(vertices, threads, **self._shown_to(builder, vertices))
        if name is None:
            return bvh
        return OPTIMISERS[name].optimise(bvh, threads, **self._shown_to(OPTIMISERS[name], vertices, bvh))

    def _shown_to(self, method, vertices, bvh: Bvh | None = None) -> dict:
        """The extra arguments of a ray-guided method, or none; `bvh`: a BVH of the triangles, if there is one."""
        return {"rays": self._rays(vertices, bvh)} if method.wants_rays and self._rays else {}

    def of_all(self, triangles: Triangles) -> Accelerated:
        """All triangles, prepared for camera rays: in the plan's BVH, or in a separate one."""
        return self.build(triangles) if self.one_tree else self.for_camera(triangles)

    def for_camera(self, triangles: Triangles) -> Accelerated:
        """A `bsah` BVH for camera rays, where the plan has no BVH or one specialised to shadow rays."""
        bvh = solid_tree(BUILDERS["bsah"].build, triangles, self.threads)
        return Accelerated(triangles, bvh, block_tree(bvh, self.threads), self.cutouts_of(triangles))

    def cutouts_of(self, triangles: Triangles) -> CutoutTree | None:
        """The tree of faces with holes; None if there are none. The last one is kept."""
        if self._cutouts is None or self._cutouts[0] is not triangles:
            self._cutouts = triangles, cutout_tree(triangles, self.threads)
        return self._cutouts[1]

    def prepare(self, triangles: Triangles, bvh: Bvh | None, culled: CullResult | None = None) -> Accelerated:
        """Convert the BVH, or the triangles if the tracer walks no BVH, to the input of this plan's tracer.

        `culled`: the triangles left by culling; None: all.
        """
        geometry = soup_of(triangles, culled, self.threads) if bvh is None else bvh
        return Accelerated(triangles, bvh, self.plan.tracer.prepare(geometry, self.threads), self.cutouts_of(triangles))

    def answer(self, accelerated: Accelerated, query: ShadowQuery, tally=None, progress=None) -> np.ndarray:
        """Trace a query with this plan's tracer: (h, w, ceil(spp / 64)) uint64; bit s = sample s is occluded."""
        return self.answer_all(accelerated, [query], tally, progress)[0]

    def answer_all(
        self, accelerated: Accelerated, queries: Sequence[ShadowQuery], tally=None, progress=None
    ) -> list[np.ndarray]:
        """Trace several queries of receivers of the same shape: the bits of each, as from `answer`."""
        bits = [new_bits(query) for query in queries]
        tracer, prepared, arguments = self.plan.tracer, accelerated.prepared, (self.threads, tally, progress)
        if tracer.trace_all is not None:
            tracer.trace_all(prepared, queries, bits, *arguments)
        else:
            for query, words in zip(queries, bits):
                tracer.trace(prepared, query, words, *arguments)
        if accelerated.cutouts is not None:
            for query, words in zip(queries, bits):
                add_shadows(accelerated.cutouts, query, words, self.threads)
        return bits


# --- The plan `auto`: it chooses the builder of each frame's tree, and its tracer chooses the way of each query -------


_RAY = 1e-7  # seconds of one thread for a ray of which nothing is known


class AutoAccelerator(Accelerator):
    """An `Accelerator` that builds the tree that its rays need.

    A tree of GOOD takes five times as long to build as one of QUICK, and rays take less time. It is built at once if
    the predicted rays make up for it. It replaces a tree that was kept as soon as the rays so far would have. So at
    most twice the necessary time is lost, however many rays follow. A tree of BEST replaces one of GOOD by the same
    rule. Trees of animated scenes are refitted from the first tree of GOOD on, and so are those of BEST.
    """

    def __init__(self, plan: Plan, threads: int):
        super().__init__(plan, threads)
        self.memory = Memory()
        self._tree_name = self._built = QUICK  # the next tree, and the last one
        self._rays_soon = self._later = 0  # rays of which only the number is known

    def begin(self, rays: int, later: int = 0) -> None:
        self.memory.begin()
        self._rays_soon, self._later = rays, later

    @property
    def builder(self) -> str:
        return self._tree_name.partition("+")[0]

    @property
    def optimiser(self) -> str | None:
        return self._tree_name.partition("+")[2] or None

    def ran(self, accelerated: Accelerated) -> Plan:
        assert accelerated.chosen is not None
        tracers = {choice.way if choice.way in TRACERS else "multifrusta" for choice in self.memory.choices}
        tree = parse_plan(f"{accelerated.chosen.builder}+{self.plan.trace}")
        return replace(tree, trace=tracers.pop() if len(tracers) == 1 else self.plan.trace)

    def culled(self, triangles: Triangles, queries) -> None:
        """Choose the builder for these queries. Nothing is culled: a quick build costs no more than culling."""
        if self._tree_name != QUICK:
            return
        n, box = solid_count(triangles), np.stack(bounds(triangles.vertices, self.threads))
        lost = self.memory.lost + self._loss(self._later)
        for query in queries:
            facts = facts_of(query, n, box)
            cost, strategy = min((rate(strategy, facts), strategy) for strategy in suited_ways(query, box))
            lost += cost * facts.rays / self.threads * lost_share(strategy)
        self._choose(lost, n)
        self._rays_soon = self._later = 0

    def _loss(self, rays: int) -> float:
        """Seconds that rays of which nothing is known lose in a tree of QUICK."""
        return rays * _RAY / self.threads * lost_share("")

    def outgrown(self, accelerated: Accelerated) -> bool:
        chosen = accelerated.chosen
        if chosen is None:
            return False
        if chosen.builder == QUICK and good_pays(chosen.memory.lost, chosen.forms.triangles):
            self._tree_name = GOOD
            return True
        if chosen.builder == GOOD and best_pays(chosen.memory.in_good, chosen.forms.triangles):
            self._optimise()
            return True
        return False

    def _optimise(self) -> None:
        """Let the next tree be one of BEST. Later ones are of GOOD until they have lost the price again."""
        precompile(best_tree_job)
        self._tree_name, self._kept = BEST, None
        self.memory.in_good = 0.0

    def _choose(self, lost: float, triangles: int) -> None:
        if self._tree_name == QUICK and good_pays(lost, triangles):
            self._tree_name = GOOD

    def build(
        self, triangles: Triangles, culled: CullResult | None = None, sample_rays: RepresentativeRays | None = None
    ) -> Accelerated:
        n = solid_count(triangles)
        self._choose(self._loss(self._rays_soon + self._later), n)
        if self._tree_name == GOOD and self._kept is None and good_pays(self.memory.lost, n):
            self._keep_trees()
        if self._kept is not None and best_pays(self.memory.in_good, n):
            self._optimise()
            self._keep_trees()
        return super().build(triangles, culled, sample_rays)

    def _keep_trees(self) -> None:
        """Refit the trees of later moments to a new one, which the next moment gets."""
        self._kept, self._updated = UPDATERS["refit"].keep(self._new_tree), None

    def _new_tree(self, vertices, threads) -> Bvh:
        tree = super()._new_tree(vertices, threads)
        self._built = self._tree_name
        if self._tree_name == BEST:
            self._tree_name = GOOD
        return tree

    def prepare(self, triangles: Triangles, bvh: Bvh | None, culled: CullResult | None = None) -> Accelerated:
        assert bvh is not None
        better = partial(self._better, triangles) if self._tree_name == QUICK and self._kept is None else None
        tracer = Auto(bvh, self.threads, self.memory, self._built, better)
        return Accelerated(triangles, bvh, tracer, self.cutouts_of(triangles))

    def _better(self, triangles: Triangles) -> Bvh:
        """A tree of GOOD, which a query needs after all."""
        self._tree_name = GOOD
        return self._tree(triangles, solid_of(triangles, None, self.threads))


def best_tree(vertices: np.ndarray, threads: int) -> Bvh:
    """A tree of BEST."""
    build, _, optimise = BEST.partition("+")
    return OPTIMISERS[optimise].optimise(BUILDERS[build].build(vertices, threads), threads)


def best_tree_job() -> Job:
    """The job of a tree of BEST, which only scenes that are asked for long need."""
    return fixed_job("best tree", lambda: best_tree(small_scene().triangles(0.0, 2).vertices, 2))


def accelerator_of(plan: Plan, threads: int) -> Accelerator:
    """The accelerator of a plan."""
    return (AutoAccelerator if plan.chooses else Accelerator)(plan, threads)


# --- The triangles of a scene in memory at its latest moment, and the trees that questions have had made for them -----


class SceneTrees:
    """What the engines of one scene share: triangles at a time, and a tree for each plan. Threads of Python may ask it.

    data : MemoryData
    """

    def __init__(self, data: MemoryData):
        self._data, self._lock = data, threading.RLock()
        self._time: float | None = None
        self._triangles: Triangles | None = None
        self._made: dict[Plan, Accelerated] = {}

    def triangles(self, time: float, threads: int) -> Triangles:
        """The triangles at a time within 0 .. `duration`; those of the latest time are kept."""
        with self._lock:
            if self._triangles is None or self._time != time:
                self._time, self._made = time, {}
                self._triangles = self._data.triangles(time, threads)
            return self._triangles

    def of(self, accelerator: Accelerator, time: float) -> Accelerated:
        """The tree of a plan at a time within 0 .. `duration`. Plans that differ only in their tracer share a BVH."""
        with self._lock:
            triangles, plan = self.triangles(time, accelerator.threads), accelerator.plan
            accelerated = self._made.get(plan)
            if accelerated is None or accelerator.outgrown(accelerated):
                similar = None if plan.chooses else next((t for p, t in self._made.items() if p.tree == plan.tree), None)
                accelerated = accelerator.build(triangles) if similar is None else accelerator.prepare(triangles, similar.bvh)
                self._made[plan] = accelerated
            return accelerated

    def forget(self, plan: Plan) -> None:
        """Make room for a better tree than that of this plan."""
        with self._lock:
            self._made.pop(plan, None)
