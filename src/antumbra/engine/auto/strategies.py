"""The tracer `auto`, which chooses the fastest tracer for each query.

A strategy is a tracer that states its cost. Predicted costs select the strategies that may be best, and timing them on
a sample of the rays decides among these. Short queries are not worth a sample. Later queries with similar features
reuse the fastest strategy.
"""

from collections.abc import Callable
from math import ceil, log2
from time import perf_counter, process_time
from typing import Any, NamedTuple

import numpy as np

from ...base.extras import METHODS, try_plugins
from ...base.progress import ProgressCallback
from ...bvh.nodes import Bvh, boxes_of
from ...kernels.marshalling import Packed, packed
from ...kernels.parallel import thread_count
from ...query.shadow_query import ShadowQuery, new_bits, ray_count
from ...scene.triangles import Triangles
from ...techniques.culling.pre_bvh_culling import Soup
from ...trace.counters import CANDIDATES, new_counters
from ...trace.light_table import STRATA
from ...trace.rays import single_rays
from ...trace.tracer import ANY, TRACERS, Bits, Box, Counters, Form, Tracer, TracerState
from ...trace.tracer_cost import QueryFeatures
from .cost_model import (
    GOOD,
    GUIDED,
    QUICK,
    build_seconds,
    choose_builder,
    cost_of,
    form_seconds,
    lost_in_quick,
    lost_share,
    predicted_rate,
    strategies,
)
from .kernel_loads import worth_loading
from .one_picture import few
from .query_features import (
    features_of,
    if_sorted,
    reorder_query,
    sample_of,
    size_of,
    spatial_order,
    tile_of,
)

# --- candidates -------------------------------------------------------------------------------------------------------

_FEW_RAYS = 256  # rays that take less time than a choice


def suitable_strategies(query: ShadowQuery, box: Box) -> list[str]:
    """The names of the tracers in the registry that suit a query and state a `Cost`.

    They include those of installed packages, which are loaded at the first query that is worth a choice.

    box : the bounds of the triangles
    """
    if query.sides.size * query.samples.shape[1] > _FEW_RAYS:
        try_plugins(METHODS)
    suitable = [name for name, tracer in strategies().items() if tracer.suits(query, box)]
    only = few()
    return [only.tracer] if only is not None and only.tracer in suitable else suitable


class SceneExtent(NamedTuple):
    """Number and bounds of a scene's triangles, which determine the features of queries."""

    triangles: int
    box: Box


class TreeForms:
    """A tree and its conversions to the forms of tracers, made on first use.

    bvh : Bvh
    threads : int
    extent : SceneExtent
        Of the scene; of the tree, if None is given.
    triangles : int
        Number of triangles in the tree.
    """

    def __init__(self, bvh: Bvh, threads: int, extent: SceneExtent | None = None):
        self.bvh, self.threads, self.triangles = bvh, threads, len(bvh.prim_ids)
        self.extent = extent or SceneExtent(self.triangles, boxes_of(bvh.nodes[:1])[0])
        self._forms: dict[Form, Any] = {}
        self._packed_single: Packed | None = None

    def of(self, form: Form) -> Any:
        """The tree in a form."""
        if form.make is None:
            return self.bvh
        if form not in self._forms:
            self._forms[form] = form.make(self.bvh, self.threads)
        return self._forms[form]

    @property
    def packed_single(self) -> Packed:
        """The form that `single` traverses, packed: flattening its arrays takes longer than tracing a few rays."""
        if self._packed_single is None:
            self._packed_single = packed(single_rays.as_built(self.bvh))
        return self._packed_single

    def missing(self, form: Form) -> bool:
        """Whether the tree has not been converted to a form yet."""
        return form.make is not None and form not in self._forms

    def conversions(self, strategies: list[str]) -> dict[str, float]:
        """Strategy -> predicted seconds to convert the tree to its form; 0 if that is done."""
        return {
            name: form_seconds(name, self.triangles) if self.missing(TRACERS[name].form) else 0.0 for name in strategies
        }


def answer_query(
    strategy: str,
    forms: TreeForms,
    query: ShadowQuery,
    threads: int,
    counters: Counters | None = None,
    progress: ProgressCallback | None = None,
) -> Bits:
    """(h, w, ceil(spp / 64)) uint64: the bits of a query, traced by the named strategy."""
    bits, tracer = new_bits(query), TRACERS[strategy]
    tracer.trace_suited(forms.of(tracer.form), query, bits, threads, counters, progress)
    return bits


# --- choice -----------------------------------------------------------------------------------------------------------

TRIAL_SHARE = 0.04  # maximum cost of a run of a trial, relative to the predicted cost of the queries since the last one
KEPT_TRIAL_SHARE = 0.12  # the same in a kept tree where one of them is loaded: later frames reuse the result
MAX_CONVERSION_SHARE = 0.1  # maximum cost of a tree conversion for a try, relative to the least predicted cost
KEPT_CONVERSION_SHARE = 0.4  # the same for each further query in the tree
MAX_TRIED = 6  # strategies
_CACHED_TREE = 200_000  # triangles of a tree that is still in a processor's cache when a trial begins
_MIN_SAMPLE_SECONDS = 8e-4  # a call alone costs a tenth of this
_SAMPLE_RAYS = 1 << 13  # of `sampled_rate`
_SAMPLE_TRIANGLES, _NEIGHBOURS, _CANDIDATE_WINDOWS = 1024, 4, 16  # of `sampled_candidates`; in runs of neighbours
_MAX_SAMPLE_SHARE = 0.1  # maximum share of the receivers in the sample
_MIN_WINDOWS = 4  # of the sample
_WINDOW = 256  # receivers per window
_HOPELESS = 12.0  # a risky strategy slower than this multiple of the best rate in one window is not tried further
_FEW_RECEIVERS = 256  # too few to be worth sorting
SORT_SECONDS = 2e-7  # seconds per receiver
_SORTED_COST = 0.75  # receivers are sorted if that reduces the predicted cost below this share
_EXPIRY = 64  # frames after which strategies are tried again
_CHANGE = 1.6  # strategies are tried again once a query takes this multiple of the measured rate

Key = tuple[int | str, ...]
"""Equal for queries with similar features: see `feature_key`."""


class StrategyChoice(NamedTuple):
    """The strategy that answered a query, and the reason."""

    strategy: str
    rays: int
    reason: str  # "prediction", "sample", "earlier query" or "few rays"
    predicted: float  # seconds of one thread, by the source that `reason` names
    tried: dict[str, float]  # strategy -> nanoseconds of one thread per ray of the sample; empty: no sample was traced
    sorted: bool = False  # the receivers were spatially sorted first
    seconds: float = 0.0  # measured: computing time of all threads


class StrategyMemory:
    """Measured rates of this frame and earlier ones, shared by queries with similar features.

    lost : float
        Seconds that a GUIDED tree would have saved all queries so far.
    in_good : float
        Seconds that queries took in GOOD trees.
    """

    def __init__(self) -> None:
        self._rates: dict[Key, tuple[int, dict[str, float]]] = {}  # with the frame in which they were measured
        self._predicted: dict[Key, int] = {}  # number of queries without a trial, by keys without their last part
        self._frame = 0
        self.choices: list[StrategyChoice] = []
        self.lost = self.in_good = 0.0
        self.ray_seconds = 0.0  # of a ray of the last query with a choice

    def begin(self) -> None:
        """Begin a frame."""
        self._frame += 1
        self.choices = []

    def rates(self, key: Key) -> dict[str, float]:
        """Strategy -> nanoseconds per ray of earlier queries; empty if there are none, or they have expired.

        While a camera walks, the sizes change from frame to frame: rates of an earlier frame with similar sizes serve.
        """
        return self._found(key)[1]

    def _found(self, key: Key) -> tuple[int, dict[str, float]]:
        """The frame in which rates were measured, and these rates."""
        near = (
            each for other, each in self._rates.items() if each[0] < self._frame and each[1] and _are_near(key, other)
        )
        frame, rates = self._rates.get(key) or max(near, key=lambda each: each[0], default=(-_EXPIRY, {}))
        return frame, rates if self._frame - frame < _EXPIRY else {}

    def repeats(self, key: Key) -> int:
        """The number of similar queries whose strategy was predicted, with this one. All of them pay for a trial."""
        return self._predicted.get(key[:-1], 0) + 1

    def learn(self, key: Key, choice: StrategyChoice, builder: str | None) -> None:
        """Store the measurements of a query; discard its rates if the strategy took much longer than before.

        builder : the name of the tree's builder, if the plan chose it
        """
        self.choices.append(choice)
        self.lost += choice.seconds * lost_share(choice.strategy)
        self.in_good += choice.seconds * (builder == GOOD)
        if not choice.rays:
            return
        self.ray_seconds = choice.seconds / choice.rays
        rate, (frame, earlier_rates) = 1e9 * self.ray_seconds, self._found(key)
        if choice.tried:
            self._rates[key] = self._frame, {**choice.tried, choice.strategy: rate}
            self._predicted.pop(key[:-1], None)
        elif rate > _CHANGE * earlier_rates.get(choice.strategy, np.inf):
            self._rates[key] = self._frame, {}  # instead of those of similar sizes
        elif choice.reason == "earlier query":
            self._rates.setdefault(key, (frame, earlier_rates))  # they follow the camera
        elif choice.reason == "prediction":
            self._predicted[key[:-1]] = self.repeats(key)


_SIZES, _SIZE_COUNT = 3, 3  # index of the first size in a `feature_key`, and their number


def _are_near(one: Key, other: Key) -> bool:
    """Whether two keys are equal but for their sizes, and these differ by a step at most."""
    first, last = _SIZES, _SIZES + _SIZE_COUNT
    if len(one) != len(other) or len(one) < last or one[:first] != other[:first] or one[last:] != other[last:]:
        return False
    return all(abs(int(a) - int(b)) <= 1 for a, b in zip(one[first:last], other[first:last]))


def feature_key(features: QueryFeatures) -> Key:
    """A key that is equal for most features that differ little."""
    sizes = (round(2.0 * log2(size)) for size in (features.tile, features.stratum, features.chunk))
    receivers = (features.receivers - 1).bit_length()  # the same for a full picture and one with some background
    return features.kind, features.samples, receivers, *sizes


class SimilarQueries(NamedTuple):
    """Queries with features like those of a query, this one included."""

    untried: int = 1  # those that may pay for a trial
    served: int = 1  # those in this tree, which share the cost of converting it: as many may follow
    last: bool = False  # whether no further one is expected, so that a trial must pay for itself


ALONE = SimilarQueries()


def choose_strategy(
    query: ShadowQuery,
    forms: TreeForms,
    features: QueryFeatures,
    conversions: dict[str, float],
    threads: int,
    known: dict[str, float],
    similar: SimilarQueries = ALONE,
) -> StrategyChoice:
    """Choose the strategy for a query.

    conversions : from `TreeForms.conversions`, of the strategies that can answer it
    known : strategy -> nanoseconds per ray of earlier queries; empty: unknown
    """
    conversion = {name: seconds / similar.served for name, seconds in conversions.items()}
    if known:
        cost = {name: 1e-9 * known[name] * features.rays + conversion[name] for name in conversion if name in known}
        strategy = min(cost, key=cost.__getitem__)
        return StrategyChoice(strategy, features.rays, "earlier query", cost[strategy], {})
    cost = {name: predicted_rate(name, features) * features.rays + conversion[name] for name in conversion}
    strategy = min((name for name in cost if not cost_of(name).load), key=cost.__getitem__)
    tried = try_strategies(query, forms, cost, conversion, features, threads, similar)
    if not tried:
        return StrategyChoice(strategy, features.rays, "prediction", cost[strategy], {})
    strategy = min(tried, key=tried.__getitem__)
    return StrategyChoice(strategy, features.rays, "sample", 1e-9 * tried[strategy] * features.rays, tried)


def worth_trying(cost: dict[str, float], conversion: dict[str, float], served: int = 1) -> list[str]:
    """The strategies that may be the fastest: the one with the least predicted cost, then others by predicted time.

    Few are tried, and the next ones win most often.

    cost : strategy -> predicted seconds, including the conversion of the tree
    conversion : strategy -> predicted seconds to convert the tree to its form, this query's share
    served : as in `SimilarQueries`
    """
    best = min(cost, key=cost.__getitem__)
    tracing = {name: cost[name] - conversion[name] for name in cost}
    return [best] + [
        name
        for name in sorted(tracing, key=tracing.__getitem__)
        if name != best
        and tracing[name] < cost_of(name).tried * cost[best]
        and may_convert(conversion[name], cost[best], served)
    ]


def may_convert(share: float, least: float, served: int) -> bool:
    """Whether a query that others answer in `least` seconds may bear this share of a conversion to try a strategy.

    By the ski-rental rule, a tree in which similar queries were served before is worth more.
    """
    return share * served < (MAX_CONVERSION_SHARE + KEPT_CONVERSION_SHARE * (served - 1)) * least


def _convertible(conversions: dict[str, float], least: float, served: int) -> int:
    """The number of strategies for which the tree has the form, or may be converted to it: see `may_convert`."""
    return sum(not seconds or may_convert(seconds / served, least, served) for seconds in conversions.values())


def sorting_pays(
    query: ShadowQuery, forms: TreeForms, features: QueryFeatures, suited: list[str], threads: int
) -> bool:
    """Whether spatially sorting scattered receivers saves more than it costs."""
    if query.sides.shape[0] > 1 or features.receivers < _FEW_RECEIVERS:
        return False
    sorted_features = if_sorted(query, features, size_of(forms.extent.box))
    cost, sorted_cost = (
        min(predicted_rate(name, each) for name in suited) * features.rays for each in (features, sorted_features)
    )
    return sorted_cost + SORT_SECONDS * features.receivers < _SORTED_COST * cost


def try_strategies(
    query: ShadowQuery,
    forms: TreeForms,
    cost: dict[str, float],
    conversion: dict[str, float],
    features: QueryFeatures,
    threads: int,
    similar: SimilarQueries = ALONE,
) -> dict[str, float]:
    """Strategy -> nanoseconds per ray, measured on a sample of the query; empty if trials cost too much.

    Shafts may be a hundred times slower than predicted. If the first window takes too long, they are not tried further.

    cost, conversion : as for `worth_trying`
    """
    names, least = worth_trying(cost, conversion, similar.served), min(cost.values())
    kept = not similar.last and any(cost_of(name).load for name in names)
    share = KEPT_TRIAL_SHARE if kept else TRIAL_SHARE
    runs = 2 if kept or forms.triangles > _CACHED_TREE else 1  # a first run also reads the tree from memory
    window = least * _WINDOW / max(features.receivers, 1) * min(1.0, STRATA / features.samples) + 1e-30  # seconds
    share /= runs if similar.last else 1
    budget, shortest = share * least * similar.untried, max(_MIN_SAMPLE_SECONDS / window, _MIN_WINDOWS)
    count = min(len(names), MAX_TRIED, int(budget / (shortest * window)))
    if count < 2 or shortest * _WINDOW > features.receivers:
        return {}
    windows = min(budget / count / window, max(_MAX_SAMPLE_SHARE * features.receivers / _WINDOW, shortest))
    first, sample = sample_of(query, 1), sample_of(query, ceil(windows))
    rates: dict[str, float] = {}
    for name in sorted(names[:count], key=lambda name: cost_of(name).is_risky):
        risky, least = cost_of(name).is_risky, min(rates.values(), default=1e30)
        if risky and _rate_of(name, forms, first, threads) > _HOPELESS * least:
            continue
        rates[name] = min(_rate_of(name, forms, sample, threads) for _ in range(runs))
    return rates


def sampled_rate(strategy: str, forms: TreeForms, query: ShadowQuery, threads: int, share: float = 0.0) -> float:
    """Nanoseconds per ray of a strategy, measured on a few windows of the query: the better of two runs.

    share : of the receivers that the windows have at least

    The first run reads the tree from memory, and may take three times as long per ray as the whole query does.
    """
    windows = max(_MIN_WINDOWS, _SAMPLE_RAYS // (_WINDOW * min(query.samples.shape[1], STRATA)))
    windows = max(windows, ceil(share * query.sides.size / _WINDOW))
    sample = sample_of(query, windows)
    return min(_rate_of(strategy, forms, sample, threads) for _ in range(2))


def sampled_candidates(tracer: Tracer, triangles: Triangles, query: ShadowQuery, features: QueryFeatures) -> float:
    """`counters.CANDIDATES` of a tracer without a tree, estimated from a few windows of the query and a few triangles.

    features : of the query

    The estimate is several times too high, because fewer triangles block fewer rays early.
    """
    solid = triangles.solid
    n = len(triangles.vertices) if solid is None else len(solid)
    step = _NEIGHBOURS * max(n // _SAMPLE_TRIANGLES, 1)
    rows = (np.arange(0, n - _NEIGHBOURS + 1, step, dtype=np.int32)[:, None] + np.arange(_NEIGHBOURS)).reshape(-1)
    ids = rows.astype(np.int32) if solid is None else solid[rows]
    sample, counters = sample_of(query, _CANDIDATE_WINDOWS), new_counters()
    tracer.trace(Soup(triangles.vertices.reshape(-1, 9).take(ids, 0), ids), sample, new_bits(sample), 1, counters)
    scale = n / max(len(ids), 1) * features.rays / max(ray_count(sample), 1)
    return scale * int(counters[CANDIDATES])


LOADED: set[str] = set()  # strategies whose kernels this process has loaded


def _rate_of(strategy: str, forms: TreeForms, query: ShadowQuery, threads: int) -> float:
    """Nanoseconds per ray of a strategy, measured on a query.

    The mean decides, because shafts may be slow in a few windows only.
    """
    tracer = TRACERS[strategy]
    form = forms.of(tracer.form)
    if strategy not in LOADED:  # the first call of a process loads kernels
        answer_query(strategy, forms, tile_of(query), threads)
        LOADED.add(strategy)
    bits, start = new_bits(query), _clock(tracer, threads)
    tracer.trace_suited(form, query, bits, threads)
    return 1e9 * (_clock(tracer, threads) - start) / max(ray_count(query), 1)


def _clock(tracer: Tracer, threads: int) -> float:
    """Seconds that all threads have computed, so that other processes do not count, or could have beside a device."""
    return process_time() if tracer.device is None else threads * perf_counter()


# --- tracer -----------------------------------------------------------------------------------------------------------

_FEW_RAYS_KEY: Key = ("few",)  # different from every `feature_key`
PREDICTION_ERROR = 4.0  # predictions from counts alone may be wrong by this factor


class TreeUpgrade(NamedTuple):
    """A better tree of the same triangles, built when it pays off."""

    build: Callable[
        [ShadowQuery], tuple[Bvh, str]
    ]  # for a query: the tree, and the name of its builder in `cost_model`
    guided: bool = False  # whether it may be a GUIDED one


class AutoState(TracerState):
    """A tree in the forms of all tracers, with the measurements of its queries.

    bvh : Bvh
    threads : int
    memory : StrategyMemory
        Outlives the tree in a sequence of frames: whoever gave it begins them.
    builder : str or None
        Name of the tree's builder in `cost_model`, if the plan chose the builder, too.
    upgrade : TreeUpgrade, optional
        None: the tree is never replaced by a better one for a query.
    plain : function, optional
        Builds a GOOD tree of the same triangles, which may replace a GUIDED one.
    extent : SceneExtent, optional
        Of the scene, if culling has left only a part of its triangles in the tree.
    once : bool
        Whether no later frame is expected to use the tree.
    """

    def __init__(
        self,
        bvh: Bvh,
        threads: int | None = None,
        memory: StrategyMemory | None = None,
        builder: str | None = None,
        upgrade: TreeUpgrade | None = None,
        plain: Callable[[], Bvh] | None = None,
        extent: SceneExtent | None = None,
        once: bool = False,
    ) -> None:
        self.once = once
        self.forms, self.memory = TreeForms(bvh, thread_count(threads), extent), memory or StrategyMemory()
        self._counts_frames = memory is None
        self.builder, self._upgrade, self._plain = builder, upgrade, plain
        self._missed = 0.0  # seconds that queries would have gained in a GOOD tree instead of a GUIDED one
        self._served: dict[Key, int] = {}

    def begin(self) -> None:
        """Begin a frame, a band of one, or a query of points."""
        if self._counts_frames:
            self.memory.begin()
        else:
            self.memory.choices = []

    def serve(self, key: Key) -> int:
        """Count a query; return the number of similar ones in this tree."""
        self._served[key] = self._served.get(key, 0) + 1
        return self._served[key]

    def improve(self, query: ShadowQuery, choice: StrategyChoice, threads: int) -> None:
        """Build a better tree if the query would lose more time in this one than the build takes.

        A cost predicted from counts alone is first checked on a sample, unless no plausible error would matter.
        """
        if self._upgrade is None:
            return
        strategy, seconds = choice.strategy, choice.predicted
        if not choice.tried and self.upgrade_pays(strategy, seconds * PREDICTION_ERROR):
            seconds = 1e-9 * sampled_rate(strategy, self.forms, query, threads) * choice.rays
        if self.upgrade_pays(strategy, seconds):
            self._replace(*self._upgrade.build(query))
            self._upgrade = None

    def _replace(self, bvh: Bvh, builder: str | None) -> None:
        """Trace later queries in another tree of the same triangles."""
        self.forms, self.builder = TreeForms(bvh, self.forms.threads, self.forms.extent), builder
        self._served = {}

    def reconsider(self, query: ShadowQuery, rates: dict[str, float], seconds: float, threads: int) -> None:
        """Replace a GUIDED tree by a GOOD one, if a strategy that prefers it is then the fastest on a sample.

        By the ski-rental rule, it is built once queries would have gained what it costs.

        rates : measured in this tree
        seconds : of the query
        """
        if self._plain is None or self.builder != GUIDED or not rates:
            return
        fastest, n = min(rates, key=rates.__getitem__), self.forms.triangles
        in_good = {name: rate / cost_of(name).guided for name, rate in rates.items()}
        name = min(in_good, key=in_good.__getitem__)
        self._missed += max(1.0 - in_good[name] / rates[fastest], 0.0) * seconds
        if self._missed > build_seconds(GOOD, n) + form_seconds(name, n):
            bvh, self._plain = self._plain(), None
            good = TreeForms(bvh, self.forms.threads, self.forms.extent)
            there, here = (
                sampled_rate(*each, query, threads, _MAX_SAMPLE_SHARE) for each in ((name, good), (fastest, self.forms))
            )
            if there < here:
                self._replace(bvh, GOOD)

    def upgrade_pays(self, strategy: str, seconds: float) -> bool:
        """Whether a query that takes `seconds` in this tree pays for a better one, although this one is there."""
        n = self.forms.triangles
        lost = lost_in_quick(strategy, seconds) - build_seconds(QUICK, n) - form_seconds(strategy, n)
        return choose_builder(n, lost, self._upgrade is not None and self._upgrade.guided) != QUICK

    @property
    def choices(self) -> list[StrategyChoice]:
        """The choices of this frame, one per query."""
        return self.memory.choices


class TreelessState(TracerState):
    """Triangles without a tree, for a tracer that states a `TreelessCost`.

    strategy : str
        Name of the tracer.
    soup : Soup
    memory : StrategyMemory
    extent : SceneExtent
        Of the scene.
    culled : bool
        Whether the soup lacks triangles that culling has dropped.
    """

    def __init__(self, strategy: str, soup: Soup, memory: StrategyMemory, extent: SceneExtent, culled: bool):
        self.strategy, self.soup, self.memory, self.culled = strategy, soup, memory, culled
        self.extent = extent

    def begin(self) -> None:
        """Begin a frame, or a query of points."""
        self.memory.choices = []

    @property
    def choices(self) -> list[StrategyChoice]:
        """The choices of this frame, one per query."""
        return self.memory.choices

    def trace(
        self,
        query: ShadowQuery,
        bits: Bits,
        threads: int,
        counters: Counters | None,
        progress: ProgressCallback | None,
        fresh: bool,
    ) -> None:
        """Answer a ShadowQuery, as `trace_shadow` does."""
        tracer = TRACERS[self.strategy]
        start = _clock(tracer, threads)
        tracer.trace(self.soup, query, bits, threads, counters, progress, fresh)
        seconds = _clock(tracer, threads) - start
        rays = features_of(query, *self.extent).rays  # known since the choice
        choice = StrategyChoice(self.strategy, rays, "prediction", 0.0, {}, seconds=seconds)
        self.memory.learn((self.strategy,), choice, None)


class AutoTracer(Tracer):
    """The tracer `auto`."""

    description = (
        "the fastest tracer for each query by predicted and measured times; alone, it chooses the builder, too"
    )
    form = ANY

    @property
    def counts_apart(self) -> bool:
        return True

    def prepare(self, geometry: Bvh, threads: int | None = None) -> AutoState:
        return AutoState(geometry, threads)

    def trace(
        self,
        prepared: AutoState | TreelessState,
        query: ShadowQuery,
        bits: Bits,
        threads: int | None = None,
        counters: Counters | None = None,
        progress: ProgressCallback | None = None,
        fresh: bool = True,
    ) -> None:
        threads = thread_count(threads)
        if isinstance(prepared, TreelessState):
            prepared.trace(query, bits, threads, counters, progress, fresh)
            return
        forms, memory = prepared.forms, prepared.memory
        rays = query.sides.size * query.samples.shape[1]
        if rays <= _FEW_RAYS:
            start = perf_counter()
            trace_single: Callable[..., None] = single_rays.trace_shadow  # also takes a packed tree
            trace_single(forms.packed_single, query, bits, threads, counters, progress)
            choice = StrategyChoice("single", rays, "few rays", 0.0, {}, seconds=perf_counter() - start)
            memory.learn(_FEW_RAYS_KEY, choice, prepared.builder)
            return
        features = features_of(query, *forms.extent)
        places, suited = None, suitable_strategies(query, forms.extent.box)
        seconds = features.rays * min(predicted_rate(name, features) for name in suited)
        suited = worth_loading(suited, 0.0 if prepared.builder == QUICK else seconds)
        # strategies are tried again once another one is loaded, or the tree may be converted to its form
        similar, conversions = feature_key(features), forms.conversions(suited)
        served = prepared.serve(similar[:_SIZES])  # those of a camera that walks, too: sizes change with the view
        key = *similar, prepared.builder or "", len(suited), _convertible(conversions, seconds, served)
        if sorting_pays(query, forms, features, suited, threads):
            places = spatial_order(query.origins[0])
            query = reorder_query(query, places)
            features = features_of(query, *forms.extent)
        among = SimilarQueries(memory.repeats(key), served, prepared.once)
        choice = choose_strategy(query, forms, features, conversions, threads, memory.rates(key), among)
        prepared.improve(query, choice, threads)
        tracer = TRACERS[choice.strategy]
        form, start = prepared.forms.of(tracer.form), _clock(tracer, threads)
        out = bits if places is None else bits[:, places]
        tracer.trace_suited(form, query, out, threads, counters, progress, fresh)
        if places is not None:
            bits[:, places] = out
        seconds = _clock(tracer, threads) - start
        memory.learn(key, choice._replace(sorted=places is not None, seconds=seconds), prepared.builder)
        prepared.reconsider(query, memory.rates(key), seconds, threads)
