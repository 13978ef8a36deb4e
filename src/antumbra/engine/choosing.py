"""The plan `auto`: it chooses the builder of each frame's tree, and its tracer chooses the way of each query."""

from dataclasses import replace
from functools import partial

import numpy as np

from ..auto.choose import Memory, suited_ways
from ..auto.facts import facts_of
from ..auto.rates import BEST, GOOD, QUICK, best_pays, good_pays, lost_share, rate
from ..auto.trace import Auto
from ..bvh.nodes import Bvh
from ..methods import BUILDERS, OPTIMISERS, TRACERS, UPDATERS
from ..plan import Plan, parse_plan
from ..query.query_bounds import bounds
from ..scene.triangles import Triangles
from ..techniques.culling.pre_bvh_culling import CullResult, solid_count, solid_of
from ..techniques.srdh.representative_rays import RepresentativeRays
from .accelerate import Accelerated, Accelerator
from .ready import Job, fixed_job, make_ready, small_scene

_RAY = 1e-7  # seconds of one thread for a ray of which nothing is known


class Choosing(Accelerator):
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
            cost, way = min((rate(way, facts), way) for way in suited_ways(query, box))
            lost += cost * facts.rays / self.threads * lost_share(way)
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
        make_ready(best_tree_job)
        self._tree_name, self._kept = BEST, None
        self.memory.in_good = 0.0

    def _choose(self, lost: float, triangles: int) -> None:
        if self._tree_name == QUICK and good_pays(lost, triangles):
            self._tree_name = GOOD

    def build(
        self, triangles: Triangles, culled: CullResult | None = None, shown: RepresentativeRays | None = None
    ) -> Accelerated:
        n = solid_count(triangles)
        self._choose(self._loss(self._rays_soon + self._later), n)
        if self._tree_name == GOOD and self._kept is None and good_pays(self.memory.lost, n):
            self._keep_trees()
        if self._kept is not None and best_pays(self.memory.in_good, n):
            self._optimise()
            self._keep_trees()
        return super().build(triangles, culled, shown)

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
    return (Choosing if plan.chooses else Accelerator)(plan, threads)
