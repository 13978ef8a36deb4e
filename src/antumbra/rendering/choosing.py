"""The plan `auto`: it chooses the builder of each frame's tree, and its tracer chooses the way of each query."""

from functools import partial

import numpy as np

from ..auto.choose import Memory, suited_ways
from ..auto.facts import facts_of
from ..auto.rates import GOOD, QUICK, good_pays, lost_share, rate
from ..auto.trace import Auto
from ..bvh.nodes import Bvh
from ..cull.cull import Culled
from ..methods import TRACERS, UPDATERS
from ..plan import Plan
from ..query.bounds import bounds
from ..scene.triangles import Triangles
from .accelerate import Accelerated, Accelerator, solid_of
from .srdh_rays import Shown, SrdhRays

_RAY = 1e-7  # seconds of one thread for a ray of which nothing is known


class Choosing(Accelerator):
    """An `Accelerator` that builds the tree that its rays need.

    A tree of GOOD takes five times as long to build as one of QUICK, and rays take less time. It is built at once if
    the predicted rays make up for it. It replaces a tree that was kept as soon as the rays so far would have. So at
    most twice the necessary time is lost, however many rays follow. Trees of animated scenes are refitted from then on.
    """

    def __init__(self, plan: Plan, threads: int, srdh_rays: SrdhRays | None = None):
        super().__init__(plan, threads, srdh_rays)
        self.memory = Memory()
        self._builder = QUICK
        self._rays_soon = self._later = 0  # rays of which only the number is known

    def begin(self, rays: int, later: int = 0) -> None:
        self.memory.begin()
        self._rays_soon, self._later = rays, later

    @property
    def builder(self) -> str:
        return self._builder

    def ran(self, accelerated: Accelerated) -> Plan:
        assert accelerated.chosen is not None
        tracers = {choice.way if choice.way in TRACERS else "multifrusta" for choice in self.memory.choices}
        return Plan(build=accelerated.chosen.builder, trace=tracers.pop() if len(tracers) == 1 else self.plan.trace)

    def culled(self, triangles: Triangles, queries) -> None:
        """Choose the builder for these queries. Nothing is culled: a quick build costs no more than culling."""
        if self._builder == GOOD:
            return
        box, lost = np.stack(bounds(triangles.vertices, self.threads)), self.memory.lost + self._loss(self._later)
        for query in queries:
            facts = facts_of(query, len(triangles.vertices), box)
            cost, way = min((rate(way, facts), way) for way in suited_ways(query, box))
            lost += cost * facts.rays / self.threads * lost_share(way)
        self._choose(lost, len(triangles.vertices))
        self._rays_soon = self._later = 0

    def _loss(self, rays: int) -> float:
        """Seconds that rays of which nothing is known lose in a tree of QUICK."""
        return rays * _RAY / self.threads * lost_share("")

    def outgrown(self, accelerated: Accelerated) -> bool:
        chosen = accelerated.chosen
        if chosen is None or chosen.builder == GOOD or not good_pays(chosen.memory.lost, chosen.forms.triangles):
            return False
        self._builder = GOOD
        return True

    def _choose(self, lost: float, triangles: int) -> None:
        if self._builder == QUICK and good_pays(lost, triangles):
            self._builder = GOOD

    def build(self, triangles: Triangles, culled: Culled | None = None, shown: Shown | None = None) -> Accelerated:
        n = len(triangles.vertices)
        self._choose(self._loss(self._rays_soon + self._later), n)
        if self._builder == GOOD and self._kept is None and good_pays(self.memory.lost, n):
            self._kept = UPDATERS["refit"].keep(self._new_tree)
        return super().build(triangles, culled, shown)

    def prepare(self, triangles: Triangles, bvh: Bvh | None, culled: Culled | None = None) -> Accelerated:
        assert bvh is not None
        better = partial(self._better, triangles) if self._builder == QUICK and self._kept is None else None
        tracer = Auto(bvh, self.threads, self.memory, self._builder, better)
        return Accelerated(triangles, bvh, tracer, self.cutouts_of(triangles))

    def _better(self, triangles: Triangles) -> Bvh:
        """A tree of GOOD, which a query needs after all."""
        self._builder = GOOD
        return self._tree(triangles, solid_of(triangles, None))


def accelerator_of(plan: Plan, threads: int, srdh_rays: SrdhRays | None = None) -> Accelerator:
    """The accelerator of a plan."""
    return (Choosing if plan.chooses else Accelerator)(plan, threads, srdh_rays)
