"""The accelerator of the plan `auto`: chooses what to build for the queries of a frame.

- **Culling.** A tree that later queries will not use, of a single frame or a moving scene, only needs the triangles
  that segments can meet [Selgrad et al. 2015]. Culling is tried if marking cells, and building a tree of the share of
  triangles that is expected to remain, cost less than a tree of all triangles. Once the cells are marked, a sample of
  the triangles gives the share, and culling is abandoned if it no longer pays.
- **Builder.** Building a GOOD tree takes five times as long as a QUICK one, but traversal is faster. A GOOD tree is
  built at once if the predicted rays pay for it, those of all expected frames together. Otherwise the cached tree is
  upgraded once traversal has lost more time than the rebuild costs (the ski-rental rule), so the total loss is at most
  twice the minimum, however many rays follow. The same rule replaces GOOD trees by BEST ones. Trees of animated scenes
  are refitted from the first GOOD tree on, BEST trees included. Where the queries are known, a GUIDED tree, built for a
  sample of their rays [Feltman et al. 2012], takes the place of a GOOD one.
- **Cones.** Queries with one apex and few samples need no tree [Olsson and Assarsson 2011]. Their predicted time is
  compared with that of a tree and its rays: for all triangles, with the better of a tree of these and a tree of those
  that culling is expected to leave, and for those that it leaves.

The tracer `auto` then chooses the strategy of each query (`auto.strategies`).
"""

import math
from collections.abc import Callable, Sequence
from functools import cache, partial
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..base.wording import counted
from ..bvh.nodes import Bvh
from ..kernels.toolchain.kernel_manifest import kernels_of_warm_up
from ..query.equal_samples import with_distinct_samples
from ..query.query_bounds import triangle_box
from ..query.shadow_query import ShadowQuery
from ..scene.lights import AMBIENT
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
from ..trace.tracer import TRACERS
from ..trace.tracer_cost import QueryFeatures, TreelessCost
from .accelerator import Accelerated, Accelerator, no_lap
from .auto.cost_model import (
    BEST,
    GOOD,
    GUIDED,
    QUICK,
    RAY_SECONDS,
    best_pays,
    choose_builder,
    form_seconds,
    lost_share,
    mark_seconds,
    predicted_rate,
    refit_seconds,
    select_seconds,
    slowness,
    tree_seconds,
)
from .auto.kernel_loads import KernelLoads
from .auto.one_picture import few
from .auto.query_features import features_of, is_scattered, size_of
from .auto.strategies import (
    AutoState,
    SceneExtent,
    TreelessState,
    TreeUpgrade,
    sampled_candidates,
    suitable_strategies,
)
from .method_registry import BUILDERS, OPTIMISERS
from .plan import Plan
from .precompilation import are_on_disk, precompile
from .tree_choice import FIRST_SHARE, NO_RAYS, LearnedTrees, TreeChoice, UpdatedTree

CULLER = "grid32"
"""The culler of `auto`."""

_WORTH_SAMPLING = 0.05  # predicted seconds with a tree from which the candidates of tracers without one are counted,
_FEW_TRIANGLES = 120_000  # unless they are few: then candidates are
_PATIENCE = 16  # frames without a new try after culling was abandoned


_loads = KernelLoads()


class Forecast(NamedTuple):
    """Predictions for the queries of a frame."""

    strategy: str | None  # of the query that takes longest; None: there is no query
    seconds: float  # of the rays
    lost: float  # seconds that a GUIDED tree would save, compared with a QUICK one
    features: list[QueryFeatures]  # of each query
    receivers: int  # those of queries that share their receivers count once


# --- The reasons of choices, see `TreeChoice.why` ---------------------------------------------------------------------

FEW_RAYS = "too few rays for a better tree"
MANY_RAYS = "rays would lose more than it costs"
LONG_RUN = "rays have lost what it costs"
MOVING = "triangles move, and it can be updated"
UPGRADED = "a query would have lost more"

# --- The accelerator --------------------------------------------------------------------------------------------------


class AutoAccelerator(Accelerator):
    """An `Accelerator` that chooses what to build by the number of rays."""

    def __init__(self, plan: Plan, threads: int, memory: LearnedTrees | None = None):
        super().__init__(plan, threads, memory)
        self._selector = RepresentativeRaySelector(SrdhRays(), threads)

    @property
    def culls(self) -> bool:
        return self.memory.expected.later == 0 and self.memory.expected.frames == 1

    def executed(self, accelerated: Accelerated) -> TreeChoice:
        choice, chosen = accelerated.choice, accelerated.chosen
        assert choice is not None and chosen is not None
        if isinstance(chosen, TreelessState):
            return choice
        if chosen.builder is not None and chosen.builder != choice.tree:
            choice = choice.with_tree(chosen.builder, UPGRADED)
        tracers = {each.strategy for each in chosen.choices}
        return choice._replace(tracer=tracers.pop()) if len(tracers) == 1 else choice

    def tree_for(
        self,
        triangles: Triangles,
        queries: Sequence[ShadowQuery],
        sample: RepresentativeRays | None = None,
        lap: Callable[[str], None] = no_lap,
    ) -> Accelerated:
        queries = [with_distinct_samples(query) for query in queries]
        memory, n = self.memory, solid_count(triangles)
        extent = SceneExtent(n, triangle_box(triangles, self.threads))
        forecast = forecast_of(queries, extent)
        once = memory.first_sight(triangles) and self.culls
        serves_once = once and few() is None
        candidates = cache(partial(_candidates, triangles, queries, forecast))
        whole = self._tree_seconds(n, forecast)
        culling = self._culling_seconds(queries, forecast, extent) if serves_once else math.inf
        treeless = (
            self._treeless(n, min(whole, culling), candidates, queries, forecast, extent) if serves_once else None
        )
        culled = None
        if treeless is None and culling < math.inf:
            culled = self._try_culling(triangles, queries, forecast, extent, whole - culling)
            if culled is None and culling < whole:  # what they were compared with does not come about
                treeless = self._treeless(n, whole, candidates, queries, forecast, extent)
        if treeless is not None:
            memory.moved(triangles)
            return self._without_tree(treeless, triangles, None, extent)
        if culled is not None:
            lap("cull")
            tree = self._builder_for(len(culled.kept), forecast.lost)
        else:
            expected = memory.expected
            self._upgrade_builder(memory.strategies.lost + _loss(expected.later) + expected.frames * forecast.lost, n)
            memory.expected = NO_RAYS
        if culled is None:
            return self._whole_tree(triangles, queries, once)
        memory.moved(triangles)
        left = self._tree_seconds(len(culled.kept), forecast)
        treeless = self._treeless(len(culled.kept), left, candidates, queries, forecast, extent)
        if treeless is not None:
            return self._without_tree(treeless, triangles, culled, extent)
        why = f"used once; {counted(len(culled.kept), 'triangle', 'matter')}"
        choice = self._choice(tree, why, CULLER)
        solid = solid_of(triangles, culled, self.threads)
        return self._prepare(choice, triangles, self._sampled_tree(choice, triangles, solid, queries), solid, extent)

    def build(self, triangles: Triangles, sample: RepresentativeRays | None = None) -> Accelerated:
        expected = self.memory.expected
        self._upgrade_builder(_loss(expected.frames * expected.soon + expected.later), solid_count(triangles))
        return self._whole_tree(triangles, [], False)

    def needs_rebuild(self, accelerated: Accelerated) -> bool:
        chosen, memory = accelerated.chosen, self.memory
        if not isinstance(chosen, AutoState):
            return False
        if chosen.builder == QUICK:
            self._upgrade_builder(chosen.memory.lost, chosen.forms.triangles)
            return memory.builder != QUICK
        soon, later, frames = memory.expected
        expected = (later + (frames - 1) * soon) * chosen.memory.ray_seconds
        if chosen.builder == GOOD and best_pays(chosen.memory.in_good + expected, chosen.forms.triangles):
            self._optimise()
            return True
        return False

    # --- what to build

    def _choice(self, tree: str, why: str, culler: str | None = None, updater: str | None = None) -> TreeChoice:
        return TreeChoice(culler, None, None, updater, self.plan.trace, why).with_tree(tree, why)

    def _choice_of_all(self, n: int, moved: bool, has_queries: bool) -> TreeChoice:
        """The choice of a tree of all n triangles.

        moved : whether the last tree had other triangles
        has_queries : whether the queries are known, and so a sample of their rays
        """
        memory, why = self.memory, MANY_RAYS
        good_pays = choose_builder(n, memory.strategies.lost, False) != QUICK
        if memory.builder != QUICK and memory.updated is None and moved and good_pays:
            memory.builder, memory.updated = GOOD, UpdatedTree("refit")
        if memory.updated is not None and best_pays(memory.strategies.in_good, n):
            self._optimise()
            memory.updated = UpdatedTree("refit")
        tree = GOOD if memory.builder == GUIDED and not has_queries else memory.builder
        if memory.updated is not None:
            why = MOVING
        elif tree in (QUICK, BEST):
            why = FEW_RAYS if tree == QUICK else LONG_RUN
        return self._choice(tree, why, updater=None if memory.updated is None else "refit")

    def _culling_seconds(self, queries: Sequence[ShadowQuery], forecast: Forecast, extent: SceneExtent) -> float:
        """Predicted seconds to cull, to build the tree of what that leaves, and to lose in it; inf: it leaves all."""
        size, memory = size_of(extent.box), self.memory
        if memory.patience or any(query.light.kind == AMBIENT and query.light.radius >= size for query in queries):
            return math.inf  # segments reach everything
        if all(is_scattered(query, extent.box) for query in queries):
            return math.inf  # so do those of points everywhere
        marking = mark_seconds(forecast.receivers, len(queries))
        return marking + _culled_seconds(forecast, extent.triangles, memory.share)

    def _try_culling(
        self,
        triangles: Triangles,
        queries: Sequence[ShadowQuery],
        forecast: Forecast,
        extent: SceneExtent,
        gain: float,
    ) -> CullResult | None:
        """The triangles that segments can meet; None if finding them costs more than it saves.

        gain : seconds that it is expected to save
        """
        n, memory = extent.triangles, self.memory
        if not _loads.pays("culling", gain):
            return None
        marking = mark_segments(triangles, queries, self.threads)
        memory.share = relevant_share(triangles, marking)
        if _culled_seconds(forecast, n, memory.share) > self._tree_seconds(n, forecast):
            memory.patience, memory.share = _PATIENCE, FIRST_SHARE
            return None
        return select_relevant(triangles, marking, self.threads)

    def _tree_seconds(self, n: int, forecast: Forecast) -> float:
        """Predicted seconds until there is a tree of n triangles, and to lose in it."""
        new = _new_tree_seconds(forecast, n)
        return new if self.memory.updated is None else min(new, refit_seconds(n, forecast.strategy))

    def _treeless(
        self,
        n: int,
        tree: float,
        candidates: Callable[[str], float],
        queries: Sequence[ShadowQuery],
        forecast: Forecast,
        extent: SceneExtent,
    ) -> str | None:
        """The tracer that is predicted to answer the queries without a tree of n triangles sooner than rays in one.

        tree : predicted seconds until there is the tree that would be built instead, and to lose in it
        candidates : the estimated number of candidates of a tracer, by its name
        """
        if not any(features.rays for features in forecast.features):
            return None
        with_tree = forecast.seconds + tree
        for name, tracer in TRACERS.items():
            cost = tracer.cost
            if not isinstance(cost, TreelessCost) or not all(tracer.suits(query, extent.box) for query in queries):
                continue
            unit = 1e-9 * slowness(name)
            seconds = unit * sum(f.rays * cost.rate(f._replace(triangles=n)) for f in forecast.features)
            if not is_compiled(f"{name} (raster)") or not _loads.pays(name, with_tree - seconds, cost.load):
                continue
            if cost.candidate and with_tree > _WORTH_SAMPLING and n > _FEW_TRIANGLES:
                seconds += unit * cost.candidate * candidates(name)
            if seconds < with_tree:
                return name
        return None

    def _builder_for(self, n: int, lost: float) -> str:
        """The builder for n triangles, if rays lose `lost` seconds in a QUICK tree."""
        name = choose_builder(n, lost, _is_guided())
        if name != GUIDED:
            return name
        gain = tree_seconds(n, lost, None, False) - tree_seconds(n, lost, None, True)
        return name if _loads.pays(GUIDED, gain) else choose_builder(n, lost, False)

    def _upgrade_builder(self, lost: float, triangles: int) -> None:
        """Choose a better builder than QUICK for later trees, if rays that lose `lost` seconds pay for it."""
        if self.memory.builder == QUICK:
            self.memory.builder = self._builder_for(triangles, lost)

    def _optimise(self) -> None:
        """Make the next tree a BEST one. Later trees are GOOD again, until they have lost the cost of another BEST."""
        precompile("best tree")
        self.memory.builder, self.memory.updated = BEST, None
        self.memory.strategies.in_good = 0.0

    # --- building it

    def _without_tree(
        self, tracer: str, triangles: Triangles, culled: CullResult | None, extent: SceneExtent
    ) -> Accelerated:
        """The triangles without a tree, for a tracer that needs none."""
        cost = TRACERS[tracer].cost
        assert isinstance(cost, TreelessCost)
        solid = None if culled is None else solid_of(triangles, culled, self.threads)
        choice = TreeChoice(None if culled is None else CULLER, None, None, None, tracer, cost.reason)
        soup = soup_of(triangles, solid, self.threads)
        state = TreelessState(tracer, soup, self.memory.strategies, extent, culled is not None)
        return Accelerated(triangles, None, state, self.cutouts_of(triangles), True, choice)

    def _whole_tree(self, triangles: Triangles, queries: Sequence[ShadowQuery], once: bool) -> Accelerated:
        """A tree of all triangles.

        queries : those to be traced in it, empty if they are not known
        once : whether no others are expected
        """
        memory = self.memory
        choice = self._choice_of_all(solid_count(triangles), memory.moved(triangles), bool(queries))
        bvh = self._sampled_tree(choice, triangles, solid_of(triangles, None, self.threads), queries)
        if choice.tree == memory.builder == BEST:
            memory.builder = GOOD
        if memory.updated is not None and memory.updated.built is not None:
            choice = choice.with_tree(memory.updated.built.tree, choice.why)
        return self._prepare(choice, triangles, bvh, None, None, once)

    def _sampled_tree(
        self, choice: TreeChoice, triangles: Triangles, solid: CullResult | None, queries: Sequence[ShadowQuery]
    ) -> Bvh:
        """The BVH of a choice, a GUIDED one for a sample of the queries' rays. The queries themselves are not kept."""
        sample = self._selector.show(queries, triangles) if choice.tree == GUIDED else None
        return self._tree(choice, triangles, solid, sample)

    def _prepare(
        self,
        choice: TreeChoice,
        triangles: Triangles,
        bvh: Bvh,
        culled: CullResult | None,
        extent: SceneExtent | None,
        once: bool = True,
    ) -> Accelerated:
        """Prepare a tree for the tracer.

        culled : the solid triangles that culling left; None: nothing is culled
        extent : of the scene, if triangles are culled
        once : as for `_whole_tree`
        """
        upgrades = choice.tree == QUICK and choice.updater is None
        upgrade = TreeUpgrade(partial(self._upgrade, triangles, culled), _is_guided()) if upgrades else None
        plain = partial(self._plain_tree, triangles) if culled is None and choice.updater is None else None
        tracer = AutoState(bvh, self.threads, self.memory.strategies, choice.tree, upgrade, plain, extent, once)
        return Accelerated(triangles, bvh, tracer, self.cutouts_of(triangles), culled is not None, choice)

    def _upgrade(self, triangles: Triangles, culled: CullResult | None, query: ShadowQuery) -> tuple[Bvh, str]:
        """A better tree of the same triangles, for a query that turns out to need it, and its builder."""
        choice = self._choice(GUIDED if _is_guided() and _loads.pays(GUIDED, math.inf) else GOOD, UPGRADED)
        if culled is None:
            self.memory.builder = choice.tree
        solid = culled or solid_of(triangles, None, self.threads)
        return self._sampled_tree(choice, triangles, solid, [query]), choice.tree

    def _plain_tree(self, triangles: Triangles) -> Bvh:
        """A GOOD tree of all triangles, for strategies that a GUIDED one does not serve."""
        self.memory.builder = GOOD
        return self._tree(self._choice(GOOD, UPGRADED), triangles, solid_of(triangles, None, self.threads), None)


def forecast_of(queries: Sequence[ShadowQuery], extent: SceneExtent) -> Forecast:
    """Predictions for these queries."""
    n, box = extent
    total, lost, most, of_queries = 0.0, 0.0, -1.0, list[QueryFeatures]()
    main: str | None = None
    receivers: dict[int, int] = {}  # those of queries that share their receivers count once
    for query in queries:
        features = features_of(query, n, box)
        receivers[id(query.origins)] = features.receivers
        of_queries.append(features)
        traced = {name: predicted_rate(name, features) * features.rays for name in suitable_strategies(query, box)}
        strategy = min(traced, key=lambda name: traced[name] + form_seconds(name, n))
        seconds = traced[strategy]
        total += seconds
        lost += seconds * lost_share(strategy)
        if seconds > most:
            most, main = seconds, strategy
    return Forecast(main, total, lost, of_queries, sum(receivers.values()))


def _candidates(triangles: Triangles, queries: Sequence[ShadowQuery], forecast: Forecast, tracer: str) -> float:
    """`sampled_candidates` of all queries."""
    return sum(sampled_candidates(TRACERS[tracer], triangles, *each) for each in zip(queries, forecast.features))


def _new_tree_seconds(forecast: Forecast, n: int) -> float:
    """Predicted seconds to build the best tree of n triangles for the rays, and to lose in it."""
    return tree_seconds(n, forecast.lost, forecast.strategy, _is_guided())


def _culled_seconds(forecast: Forecast, n: int, share: float) -> float:
    """Predicted seconds to select a share of n triangles, to build the best tree of them, and to lose in it."""
    return select_seconds(n, share) + _new_tree_seconds(forecast, round(share * n))


def _loss(rays: int) -> float:
    """Seconds that unknown rays would lose in a QUICK tree."""
    return rays * RAY_SECONDS * lost_share(None)


def _is_guided() -> bool:
    """Whether the kernels of GUIDED trees are on disk."""
    return is_compiled(f"{GUIDED}+single (raster)")


def best_tree(vertices: NDArray[np.float32], threads: int) -> Bvh:
    """A BEST tree."""
    build, _, optimise = BEST.partition("+")
    bvh: Bvh = OPTIMISERS[optimise].optimise(BUILDERS[build].build(vertices, threads), threads)
    return bvh


@cache
def is_compiled(example: str) -> bool:
    """Whether all kernels recorded for an example were on disk when this process first asked; True without a record."""
    kernels = kernels_of_warm_up(example)
    return kernels is None or are_on_disk(kernels)  # other packages record none


def accelerator_of(plan: Plan, threads: int) -> Accelerator:
    """The accelerator of a plan."""
    return (AutoAccelerator if plan.chooses else Accelerator)(plan, threads)
