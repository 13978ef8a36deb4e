"""The accelerator of the plan `auto`: chooses what to build for the queries of a frame.

- **Culling.** A tree that later queries will not use, of a first frame or a moving scene, only needs the triangles that
  segments can meet [Selgrad et al. 2015]. Culling is tried if marking cells, and building a tree of the share of
  triangles that is expected to remain, cost less than a tree of all triangles. Once the cells are marked, a sample of
  the triangles tells the share, and culling is abandoned if it no longer pays.
- **Builder.** Building a GOOD tree takes five times as long as a QUICK one, but traversal is faster. A GOOD tree is
  built at once if the predicted rays pay for it. Otherwise the cached tree is upgraded once traversal has lost more
  time than the rebuild costs (the ski-rental rule), so the total loss is at most twice the minimum, however many rays
  follow. The same rule replaces GOOD trees by BEST ones. Trees of animated scenes are refitted from the first GOOD tree
  on, BEST trees included. Where the queries are known, a GUIDED tree, built for a sample of their rays [Feltman et al.
  2012], takes the place of a GOOD one.
- **Cones.** Queries with one apex, few samples and many rays per triangle need no tree [Olsson and Assarsson 2011].

The tracer `auto` then chooses the strategy of each query (`auto.strategies`).
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import cache, partial
from typing import ClassVar, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..bvh.nodes import Bvh
from ..kernels.toolchain.kernel_manifest import kernels_of_job
from ..query.query_bounds import bounds
from ..query.shadow_query import ShadowQuery
from ..scene.lights import AMBIENT, DIRECTIONAL, FIXED
from ..scene.triangles import Triangles
from ..techniques.culling.pre_bvh_culling import (
    CullResult,
    mark_segments,
    relevant_share,
    select_relevant,
    solid_count,
    solid_of,
    soup_of,
)
from ..techniques.srdh.representative_rays import (
    RepresentativeRays,
    RepresentativeRaySelector,
    SrdhRays,
)
from ..trace.rays.ray_hits import Intersections
from .accelerator import Accelerated, Accelerator
from .auto.cost_model import (
    BEST,
    GOOD,
    GUIDED,
    QUICK,
    RAY_SECONDS,
    best_pays,
    choose_builder,
    lost_share,
    mark_seconds,
    predicted_rate,
    refit_seconds,
    select_seconds,
    tree_seconds,
)
from .auto.query_features import features_of, is_scattered, size_of
from .auto.strategies import AutoTracer, ConeTracer, SceneExtent, StrategyMemory, TreeUpgrade, suitable_strategies
from .method_registry import BUILDERS, OPTIMISERS, TRACERS, UPDATERS
from .plan import Plan, parse_plan
from .precompilation import Job, are_on_disk, fixed_job, precompile, small_scene

CULLER = "grid32"
"""The culler of `auto`."""

_FIRST_SHARE = 0.3  # of the triangles: expected to remain after culling, before anything is known
_PATIENCE = 16  # frames without a new try after culling was abandoned
_CONE_SHARE = 0.03  # triangles per ray up to which cones are the faster ones
_CONE_SAVING = 0.25  # of the time of the rays
_MAX_CONE_SAMPLES = 4


class KernelLoads:
    """Decides when methods are worth loading: their kernels take time, once per process.

    By the ski-rental rule, a method is loaded once the queries so far would have gained that time.
    """

    SECONDS: ClassVar[dict[str, float]] = {"culling": 0.02, GUIDED: 0.03, "cones": 0.03}

    def __init__(self) -> None:
        self._due = dict(self.SECONDS)  # method -> seconds still to be gained; 0: loaded

    def pays(self, method: str, gain: float) -> bool:
        """Whether a method that gains `gain` seconds in a query should be used, and so loaded."""
        if gain <= 0.0:
            return False
        self._due[method] = max(self._due[method] - gain, 0.0)
        return self._due[method] == 0.0


_loads = KernelLoads()


class Forecast(NamedTuple):
    """Predictions for the queries of a frame."""

    strategy: str  # of the query that takes longest
    seconds: float  # of the rays
    lost: float  # seconds that a GUIDED tree would save, compared with a QUICK one
    rays: int
    receivers: int


class AutoAccelerator(Accelerator):
    """An `Accelerator` that chooses what to build by the number of rays."""

    def __init__(self, plan: Plan, threads: int):
        super().__init__(plan, threads)
        self.memory = StrategyMemory()
        self._tree_name = self._next_name = QUICK  # of later trees of all triangles, and of the next tree
        self._built_name = QUICK  # of the last tree
        self._rays_soon = self._later = 0  # predicted numbers of rays: of the coming queries, and of later ones
        self._share, self._patience = _FIRST_SHARE, 0
        self._tried: Triangles | None = None  # the triangles of the last try of culling
        self._by_cones = False  # whether the next queries go to cones
        self._latest: Triangles | None = None  # of the last tree
        self._moves = False  # whether they have changed between trees
        self._extent: SceneExtent | None = None  # of the scene with the triangles of the last queries
        self._sample: RepresentativeRays | None = None  # rays of the present queries, for a GUIDED tree
        self._selector = RepresentativeRaySelector(SrdhRays(), threads)

    def begin(self, rays: int, later: int = 0) -> None:
        self.memory.begin()
        self._rays_soon, self._later = rays, later
        self._patience = max(self._patience - 1, 0)

    @property
    def culls(self) -> bool:
        return self._later == 0

    @property
    def builder(self) -> str:
        return self._next_name.partition("+")[0]

    @property
    def optimiser(self) -> str | None:
        return self._next_name.partition("+")[2] or None

    def executed_plan(self, accelerated: Accelerated) -> Plan:
        assert accelerated.chosen is not None
        tracers = {choice.strategy if choice.strategy in TRACERS else "multifrusta" for choice in self.memory.choices}
        if isinstance(accelerated.chosen, ConeTracer):
            return Plan(CULLER if accelerated.chosen.culled else None, trace="cones")
        cull = CULLER if accelerated.partial else None
        tree = parse_plan(f"{accelerated.chosen.builder}+{self.plan.trace}")
        return replace(tree, trace=tracers.pop() if len(tracers) == 1 else self.plan.trace, cull=cull)

    def cull(self, triangles: Triangles, queries: Sequence[ShadowQuery]) -> CullResult | None:
        """Choose the builder for these queries, and cull if that pays."""
        n, box = solid_count(triangles), np.stack(bounds(triangles.vertices, self.threads))
        self._extent = SceneExtent(n, box)
        forecast, serves_once = self._forecast(queries), self._serves_once(triangles)
        culled = self._try_culling(triangles, queries, forecast) if serves_once else None
        remaining = n if culled is None else len(culled.kept)
        self._by_cones = serves_once and self._cones_pay(remaining, queries, forecast)
        if culled is not None:
            self._next_name = self._builder_for(len(culled.kept), forecast.lost)
        else:
            self._choose(self.memory.lost + self._loss(self._later) + forecast.lost, n)
            self._rays_soon = self._later = 0
            self._next_name = self._tree_name
        self._take_sample(triangles, queries)
        return culled

    def _forecast(self, queries: Sequence[ShadowQuery]) -> Forecast:
        """Predictions for these queries."""
        assert self._extent is not None
        n, box = self._extent
        total, lost, most, main, rays = 0.0, 0.0, -1.0, "", 0
        receivers: dict[int, int] = {}  # those of queries that share their receivers count once
        for query in queries:
            features = features_of(query, n, box)
            receivers[id(query.origins)] = features.receivers
            rays += features.rays
            rate, strategy = min((predicted_rate(name, features), name) for name in suitable_strategies(query, box))
            seconds = rate * features.rays
            total += seconds
            lost += seconds * lost_share(strategy)
            if seconds > most:
                most, main = seconds, strategy
        return Forecast(main, total, lost, rays, sum(receivers.values()))

    def _serves_once(self, triangles: Triangles) -> bool:
        """Whether the next tree may serve the present queries only: no later ones have used these triangles yet."""
        serves_once = self.culls and triangles is not self._tried
        self._tried = triangles
        return serves_once

    def _cones_pay(self, n: int, queries: Sequence[ShadowQuery], forecast: Forecast) -> bool:
        """Whether cones are likely to answer the queries faster than rays in a tree of n triangles."""
        fits = all(has_one_apex(query) and query.samples.shape[1] <= _MAX_CONE_SAMPLES for query in queries)
        if not fits or n > _CONE_SHARE * forecast.rays or not is_compiled("cones (raster)"):
            return False
        return _loads.pays("cones", _CONE_SAVING * forecast.seconds)

    def _try_culling(
        self, triangles: Triangles, queries: Sequence[ShadowQuery], forecast: Forecast
    ) -> CullResult | None:
        """The triangles that segments can meet; None if finding them costs more than it saves."""
        assert self._extent is not None
        n, size = self._extent.triangles, size_of(self._extent.box)
        if self._patience or any(query.light.kind == AMBIENT and query.light.radius >= size for query in queries):
            return None  # segments reach everything
        if all(is_scattered(query, self._extent.box) for query in queries):
            return None  # so do those of points everywhere
        direct = tree_seconds(n, forecast.lost, forecast.strategy, self._guided)
        if self.updater is not None:
            direct = min(direct, refit_seconds(n, forecast.strategy))
        tree = partial(tree_seconds, lost=forecast.lost, strategy=forecast.strategy, guided=self._guided)
        select, mark = select_seconds(n), mark_seconds(forecast.receivers, len(queries))
        if not _loads.pays("culling", direct - mark - select - tree(round(self._share * n))):
            return None
        marking = mark_segments(triangles, queries, self.threads)
        self._share = relevant_share(triangles, marking)
        if select + tree(round(self._share * n)) > direct:
            self._patience, self._share = _PATIENCE, _FIRST_SHARE
            return None
        return select_relevant(triangles, marking, self.threads)

    def _loss(self, rays: int) -> float:
        """Seconds that unknown rays would lose in a QUICK tree."""
        return rays * RAY_SECONDS * lost_share("")

    def needs_rebuild(self, accelerated: Accelerated) -> bool:
        chosen = accelerated.chosen
        if not isinstance(chosen, AutoTracer):
            return False
        if chosen.builder == QUICK:
            self._choose(chosen.memory.lost, chosen.forms.triangles)
            return self._tree_name != QUICK
        expected = self._later * chosen.memory.ray_seconds
        if chosen.builder == GOOD and best_pays(chosen.memory.in_good + expected, chosen.forms.triangles):
            self._optimise()
            return True
        return False

    def _builder_for(self, n: int, lost: float) -> str:
        """The builder for n triangles, if rays lose `lost` seconds in a QUICK tree."""
        name = choose_builder(n, lost, self._guided)
        if name != GUIDED:
            return name
        gain = tree_seconds(n, lost, "", False) - tree_seconds(n, lost, "", True)
        return name if _loads.pays(GUIDED, gain) else choose_builder(n, lost, False)

    def _optimise(self) -> None:
        """Make the next tree a BEST one. Later trees are GOOD again, until they have lost the cost of another BEST."""
        precompile(best_tree_job)
        self._tree_name, self.updater = BEST, None
        self.memory.in_good = 0.0

    def _choose(self, lost: float, triangles: int) -> None:
        if self._tree_name == QUICK:
            self._tree_name = self._builder_for(triangles, lost)

    @property
    def _guided(self) -> bool:
        """Whether the kernels of GUIDED trees are on disk."""
        return is_compiled(f"{GUIDED}+single (raster)")

    def build(
        self, triangles: Triangles, culled: CullResult | None = None, sample_rays: RepresentativeRays | None = None
    ) -> Accelerated:
        try:
            self._moves = self._latest is not None and self._latest is not triangles
            self._latest = triangles
            solid = solid_of(triangles, culled, self.threads) if culled is not None else None
            self._rays = self._rays_among(triangles.solid if solid is None else solid.kept)
            if self._by_cones:
                self._by_cones = False
                tracer = ConeTracer(soup_of(triangles, solid, self.threads), self.memory, culled is not None)
                return Accelerated(triangles, None, tracer, self.cutouts_of(triangles), True)
            if solid is not None:
                return self._prepare(triangles, self._tree(triangles, solid), solid)
            self._choose_for_all(solid_count(triangles))
            return super().build(triangles, None, sample_rays)
        finally:
            self._rays = self._sample = None

    def _rays_among(self, ids: NDArray[np.int32] | None) -> Callable[[NDArray[np.float32], Bvh | None], Intersections]:
        """A function that finds what the sample rays meet among the triangles `ids`; None: all."""

        def rays(vertices: NDArray[np.float32], bvh: Bvh | None) -> Intersections:
            assert self._sample is not None
            return self._sample.among(vertices, ids, self.threads, bvh)

        return rays

    def _choose_for_all(self, n: int) -> None:
        """Choose the next tree of all triangles, and whether to refit it."""
        self._choose(self._loss(self._rays_soon + self._later), n)
        good_pays = choose_builder(n, self.memory.lost, False) != QUICK
        if self._tree_name != QUICK and self.updater is None and self._moves and good_pays:
            self._tree_name = GOOD
            self._start_refitting()
        if self.updater is not None and best_pays(self.memory.in_good, n):
            self._optimise()
            self._start_refitting()
        self._next_name = GOOD if self._tree_name == GUIDED and self._sample is None else self._tree_name

    def _start_refitting(self) -> None:
        """Build a new tree at the next time sample, and refit it at later ones."""
        self.updater, self._updated = UPDATERS["refit"].keep(self.new_tree), None

    def new_tree(self, vertices: NDArray[np.float32], threads: int) -> Bvh:
        tree = super().new_tree(vertices, threads)
        self._built_name = self._next_name
        if self._tree_name == BEST == self._next_name:
            self._tree_name = self._next_name = GOOD
        return tree

    def prepare(self, triangles: Triangles, bvh: Bvh | None, culled: CullResult | None = None) -> Accelerated:
        assert bvh is not None
        return self._prepare(triangles, bvh, None)

    def _prepare(self, triangles: Triangles, bvh: Bvh, culled: CullResult | None) -> Accelerated:
        """Prepare a tree for the tracer; `culled`: the solid triangles that culling left; None: nothing is culled."""
        is_partial = culled is not None
        upgrades = self._built_name == QUICK and (is_partial or self.updater is None)
        upgrade = TreeUpgrade(partial(self._upgrade, triangles, culled), self._guided) if upgrades else None
        extent = self._extent if is_partial else None
        tracer = AutoTracer(bvh, self.threads, self.memory, self._built_name, upgrade, extent)
        return Accelerated(triangles, bvh, tracer, self.cutouts_of(triangles), is_partial)

    def _upgrade(self, triangles: Triangles, culled: CullResult | None, query: ShadowQuery) -> tuple[Bvh, str]:
        """A better tree of the same triangles, for a query that turns out to need it, and its builder."""
        self._next_name = GUIDED if self._guided and _loads.pays(GUIDED, math.inf) else GOOD
        if culled is None:
            self._tree_name = self._next_name
        solid = culled or solid_of(triangles, None, self.threads)
        self._take_sample(triangles, [query])
        try:
            self._rays = self._rays_among(None if solid is None else solid.kept)
            return self._tree(triangles, solid), self._next_name
        finally:
            self._rays = self._sample = None

    def _take_sample(self, triangles: Triangles, queries: Sequence[ShadowQuery]) -> None:
        """Sample the rays of queries if the next tree is a GUIDED one. The queries themselves are not kept."""
        if self._next_name == GUIDED:
            self._sample = self._selector.show(queries, triangles)


def best_tree(vertices: NDArray[np.float32], threads: int) -> Bvh:
    """A BEST tree."""
    build, _, optimise = BEST.partition("+")
    bvh: Bvh = OPTIMISERS[optimise].optimise(BUILDERS[build].build(vertices, threads), threads)
    return bvh


def best_tree_job() -> Job:
    """The job of building a BEST tree, which only long runs of queries need."""
    return fixed_job("best tree", lambda: best_tree(small_scene().triangles(0.0, 2).vertices, 2))


def has_one_apex(query: ShadowQuery) -> bool:
    """Whether all segments of a query end in one point or have one direction."""
    light = query.light
    return light.kind == DIRECTIONAL or (light.kind == FIXED and not np.any(light.u) and not np.any(light.v))


@cache
def is_compiled(job: str) -> bool:
    """Whether all kernels recorded for a job were on disk when this process first asked."""
    return are_on_disk(kernels_of_job(job))


def accelerator_of(plan: Plan, threads: int) -> Accelerator:
    """The accelerator of a plan."""
    return (AutoAccelerator if plan.chooses else Accelerator)(plan, threads)
