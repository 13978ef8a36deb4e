"""Strategies to trace a query, and the tracer `auto`, which chooses the fastest for each query.

A strategy is a tracer over a form of the tree. Predicted costs say which strategies may be best, and a sample of the
rays decides among them. Short queries are not worth a sample. Later queries of like features take the strategy that was
fastest.
"""

from collections.abc import Callable
from math import ceil, log2
from time import perf_counter
from typing import Any, NamedTuple

import numpy as np

from ...bvh.block_tree import BlockTree, block_tree
from ...bvh.nodes import Bvh, boxes_of
from ...bvh.wide_bvh import widen
from ...kernels.marshalling import Packed, packed
from ...kernels.parallel import thread_count
from ...query.shadow_query import ShadowQuery, new_bits, ray_count
from ...trace.frusta.multi_frusta import trace_tree_list
from ...trace.light_table import STRATA
from ...trace.packets.packet16 import over_pixels, over_samples
from ...trace.packets.ray_tile import is_far, is_incoherent
from ...trace.rays import single_rays as single
from ...trace.tree_list import whole
from .cost_model import GOOD, better_seconds, form_seconds, lost_in_quick, lost_share, predicted_rate
from .query_features import (
    QueryFeatures,
    features_of,
    halves_of,
    if_sorted,
    reorder_query,
    sample_of,
    size_of,
    spatial_order,
    tile_of,
)

# --- The ways to trace a query: a tracer over a form of the tree ------------------------------------------------------


class Strategy(NamedTuple):
    """A tracer, and the form of the tree that it walks."""

    form: Callable[[Bvh, int], Any] | None  # makes it; None: the builder's own tree
    trace: Callable  # trace(form, query, bits, threads, counters, progress)
    suits: Callable[[ShadowQuery, np.ndarray], bool] = lambda query, box: True  # box: around the triangles


def _trace_shafts(tree: BlockTree, query, bits, threads, counters, progress) -> None:
    trace_tree_list(whole(tree), query, bits, threads, counters, progress)


def _shafts_suit(query: ShadowQuery, box: np.ndarray) -> bool:
    return not (is_incoherent(query) or is_far(query, box))


STRATEGIES: dict[str, Strategy] = {
    "multifrusta": Strategy(block_tree, _trace_shafts, _shafts_suit),
    "packet16:blocks": Strategy(block_tree, over_pixels),
    "packet16": Strategy(None, over_pixels),
    "packet16:samples": Strategy(None, over_samples),
    "wide": Strategy(widen, single.trace_shadow),
    "single": Strategy(single.as_built, single.trace_shadow),
}
"""Name -> way. `packet16:blocks` are the packets to which the tracer `multifrusta` hands hemispheres."""


class TreeForms:
    """A tree in all forms that ways have asked for.

    bvh : Bvh
    threads : int
    triangles : int
    box : (2, 3) float32, around them
    """

    def __init__(self, bvh: Bvh, threads: int):
        self.bvh, self.threads = bvh, threads
        self.triangles, self.box = len(bvh.prim_ids), boxes_of(bvh.nodes[:1])[0]
        self._made: dict[Callable, Any] = {}
        self._for_few: Packed | None = None

    def of(self, way: Strategy) -> Any:
        """The form that a way walks."""
        if way.form is None:
            return self.bvh
        if way.form not in self._made:
            self._made[way.form] = way.form(self.bvh, self.threads)
        return self._made[way.form]

    @property
    def for_few(self) -> Packed:
        """The form that `single` walks, packed: few rays take less time than its arrays would take to be flattened."""
        if self._for_few is None:
            self._for_few = packed(single.as_built(self.bvh))
        return self._for_few

    def missing(self, way: Strategy) -> bool:
        """Must the way's form still be made?"""
        return way.form is not None and way.form not in self._made


def answer_query(
    way: str, forms: TreeForms, query: ShadowQuery, threads: int, counters=None, progress=None
) -> np.ndarray:
    """(h, w, ceil(spp / 64)) uint64: the bits of a query."""
    bits = new_bits(query)
    STRATEGIES[way].trace(forms.of(STRATEGIES[way]), query, bits, threads, counters, progress)
    return bits


# ---------------------------------------------------------------------------------------------------------------------
# Chooses a way for a query: predicted costs say which ways may be best, and a sample of the rays decides among them.
#
# Short queries are not worth a sample. Later queries of like facts take the way that was fastest.


_TRY = 0.02  # seconds of a query that are worth the try of one more way
_MAKING = 0.25  # of the least cost may be spent on a form of the tree for a try
_MOST = 0.1  # of the receivers are in the sample, at most
_LIKELY = 2.2  # times the least predicted cost: slower ways are not tried
_SHARE = 0.005  # of the receivers are in the sample, at least
_SAMPLE = 1.5e-3  # seconds that the sample should take, at least: a call costs some tenths of them
_WINDOWS = 4  # of the sample, at least
_WINDOW = 256  # receivers of a window
_RISKY = {"multifrusta": 5.0}  # way of which predictions are wrong by far -> times the least predicted cost
_HOPELESS = 12.0  # times the best rate so far, in one window: the way is not tried further
_FEW = 256  # receivers that are not worth sorting
_SORT = 2e-7  # seconds for a receiver
_SURELY = 0.75  # of the predicted cost: sorting is to save at least the rest
_AGAIN = 64  # frames after which ways are tried again
_CHANGE = 1.6  # times the rate that was measured: ways are tried again


class StrategyChoice(NamedTuple):
    """The way that answered a query, and the reason."""

    way: str
    rays: int
    reason: str  # "prediction", "sample" or "earlier query"
    predicted: float  # seconds, for the reason
    tried: dict[str, float]  # way -> nanoseconds a ray of the sample; empty if there was none
    sorted: bool = False  # the receivers were put in order first
    seconds: float = 0.0  # measured


class StrategyMemory:
    """The rates that queries had in this frame and in earlier ones. Queries of like facts share them.

    lost : float
        Seconds that all queries so far would have been faster in a tree of GOOD.
    in_good : float
        Seconds that queries took in trees of GOOD.
    """

    def __init__(self):
        self._rates: dict[tuple, tuple[int, dict[str, float]]] = {}  # with the frame in which they were tried
        self._frame = 0
        self.choices: list[StrategyChoice] = []
        self.lost = self.in_good = 0.0

    def begin(self) -> None:
        """Begin a frame."""
        self._frame += 1
        self.choices = []

    def rates(self, key: tuple) -> dict[str, float]:
        """Way -> nanoseconds a ray, of earlier queries."""
        tried, rates = self._rates.get(key, (-_AGAIN, {}))
        return rates if self._frame - tried < _AGAIN else {}

    def learn(self, key: tuple, choice: StrategyChoice, tree: str | None) -> None:
        """Keep what a query has measured; forget its rates if the way took much longer than before.

        tree : the name of its tree, if it was chosen
        """
        self.choices.append(choice)
        self.lost += choice.seconds * lost_share(choice.way)
        self.in_good += choice.seconds * (tree == GOOD)
        if not choice.rays:
            return
        now, before = 1e9 * choice.seconds / choice.rays, self.rates(key)
        if choice.tried:
            self._rates[key] = self._frame, {**choice.tried, choice.way: now}
        elif now > _CHANGE * before.get(choice.way, np.inf):
            self._rates.pop(key, None)


def feature_key(facts: QueryFeatures) -> tuple:
    """Equal for facts that differ little."""
    sizes = (round(2.0 * log2(size)) for size in (facts.tile, facts.stratum, facts.chunk))
    return facts.kind, facts.samples, facts.receivers.bit_length(), *sizes


def choose_strategy(
    query: ShadowQuery, forms: TreeForms, facts: QueryFeatures, suited: list[str], threads: int, known: dict[str, float]
) -> StrategyChoice:
    """Choose the way for a query.

    suited : the ways that can answer it
    known : way -> nanoseconds a ray, of earlier queries; empty: not known
    """
    made = {name: form_seconds(name, facts.triangles) * forms.missing(STRATEGIES[name]) for name in suited}
    if known:
        cost = {name: 1e-9 * known[name] * facts.rays + made[name] for name in suited if name in known}
        way = min(cost, key=cost.__getitem__)
        return StrategyChoice(way, facts.rays, "earlier query", cost[way], {})
    cost = {name: predicted_rate(name, facts) * facts.rays / threads + made[name] for name in suited}
    way = min(cost, key=cost.__getitem__)
    likely = worth_trying(cost, made)
    if len(likely) == 1:
        return StrategyChoice(way, facts.rays, "prediction", cost[way], {})
    tried = try_strategies(query, forms, likely, facts, cost[way] / max(facts.rays, 1), threads)
    way = min(tried, key=tried.__getitem__)
    return StrategyChoice(way, facts.rays, "sample", 1e-9 * tried[way] * facts.rays, tried)


def worth_trying(cost: dict[str, float], made: dict[str, float]) -> list[str]:
    """The ways that a sample should decide among: the more, the longer the query takes.

    cost : way -> predicted seconds, with those to make its form of the tree
    made : way -> these seconds
    """
    best, *others = sorted(cost, key=cost.__getitem__)
    likely = [
        name
        for name in others
        if cost[name] < _RISKY.get(name, _LIKELY) * cost[best] and made[name] < _MAKING * cost[best]
    ]
    likely.sort(key=lambda name: name not in _RISKY)
    return [best, *likely[: int(cost[best] / _TRY)]]


def sorting_pays(query: ShadowQuery, forms: TreeForms, facts: QueryFeatures, suited: list[str], threads: int) -> bool:
    """Will the rays of scattered receivers gain what it costs to sort them in space?"""
    if query.sides.shape[0] > 1 or facts.receivers < _FEW:
        return False
    near = if_sorted(query, facts, size_of(forms.box))
    cost, sorted_cost = (
        min(predicted_rate(way, each) for way in suited) * facts.rays / threads for each in (facts, near)
    )
    return sorted_cost + _SORT * facts.receivers < _SURELY * cost


def suitable_strategies(query: ShadowQuery, box: np.ndarray) -> list[str]:
    """The names of the ways that can answer a query; `box`: around the triangles."""
    return [name for name, way in STRATEGIES.items() if way.suits(query, box)]


def try_strategies(
    query, forms: TreeForms, ways: list[str], facts: QueryFeatures, of_ray: float, threads: int
) -> dict[str, float]:
    """Way -> nanoseconds a ray, on a sample of the query.

    Shafts may be a hundred times slower than predicted. If one window takes too long, they are not tried further.

    of_ray : predicted seconds for a ray
    """
    rays_of_window = _WINDOW * min(facts.samples, STRATA)
    first, sample = sample_of(query, 1), _sample(query, facts.receivers, _SAMPLE / (of_ray * rays_of_window))
    found: dict[str, float] = {}
    for name in sorted(ways, key=lambda name: name in _RISKY):
        if name in _RISKY and _rate_of(name, forms, first, threads) > _HOPELESS * min(found.values(), default=1e30):
            continue
        found[name] = _rate_of(name, forms, sample, threads)
    return found


def _sample(query: ShadowQuery, receivers: int, windows: float) -> ShadowQuery:
    """A sample of about so many windows, within its limits."""
    least = max(_WINDOWS, _SHARE * receivers / _WINDOW, windows)
    return sample_of(query, ceil(min(least, _MOST * receivers / _WINDOW)))


def sampled_rate(way: str, forms: TreeForms, query: ShadowQuery, threads: int) -> float:
    """Nanoseconds a ray of a way, on a sample of the query."""
    receivers = int(np.count_nonzero(query.sides))
    return _rate_of(way, forms, _sample(query, receivers, _WINDOWS), threads)


def _rate_of(way: str, forms: TreeForms, query: ShadowQuery, threads: int) -> float:
    """Nanoseconds a ray of a way, on the faster half of the query. A single window may take as long as all others.

    The first call of a process loads kernels, so a few rays go before.
    """
    answer_query(way, forms, tile_of(query), threads)
    rates = []
    for half in halves_of(query):
        start = perf_counter()
        answer_query(way, forms, half, threads)
        rates.append(1e9 * (perf_counter() - start) / max(ray_count(half), 1))
    return min(rates)


# --- The tracer `auto`: it answers each query in the way that should be fastest ---------------------------------------


_FEW_RAYS_OF_QUERY = 256  # rays that take less time than a choice
_FEW_RAYS = ("few",)  # like no other queries
_DOUBT = 16.0  # predictions from counts alone, for a reference machine, may be wrong by this factor


class AutoTracer:
    """A tree, and what its questions have measured.

    bvh : Bvh
    threads : int
    memory : Memory
        Outlives the tree in a sequence of frames.
    builder : str or None
        Name of the tree in `rates`, if it was chosen, too.
    better : function, optional
        Builds a tree of GOOD of the same triangles; None: the tree is as good as it gets.
    """

    def __init__(
        self, bvh: Bvh, threads: int | None = None, memory: StrategyMemory | None = None, builder: str | None = None,
        better: Callable[[], Bvh] | None = None,
    ):  # fmt: skip
        self.forms, self.memory, self.builder = (
            TreeForms(bvh, thread_count(threads)),
            memory or StrategyMemory(),
            builder,
        )
        self._better = better

    def begin(self) -> None:
        """Begin a frame, or a query of points."""
        self.memory.begin()

    def improve(self, query: ShadowQuery, choice: StrategyChoice, threads: int) -> None:
        """Build a better tree if the query would lose more time in this one than that takes.

        What was predicted from counts alone is measured by a sample first, unless it is far from mattering.
        """
        if self._better is None:
            return
        way, triangles = choice.way, self.forms.triangles
        seconds = choice.predicted
        if not choice.tried and lost_in_quick(way, seconds, triangles) * _DOUBT > better_seconds(way, triangles):
            seconds = 1e-9 * sampled_rate(way, self.forms, query, threads) * choice.rays
        if lost_in_quick(way, seconds, triangles) > better_seconds(way, triangles):
            self.forms, self.builder, self._better = TreeForms(self._better(), self.forms.threads), GOOD, None

    @property
    def choices(self) -> list[StrategyChoice]:
        """The choices of this frame, one for each query."""
        return self.memory.choices


def trace_shadow(auto: AutoTracer, query: ShadowQuery, bits, threads=None, counters=None, progress=None) -> None:
    """Answer a ShadowQuery: set bit s of ``bits[y, x]`` where sample s is occluded.

    bits : (h, w, ceil(spp / 64)) uint64, zeros on entry
    counters : from `new_counters`, or None
    """
    threads, forms, memory = thread_count(threads), auto.forms, auto.memory
    rays = query.sides.size * query.samples.shape[1]
    if rays <= _FEW_RAYS_OF_QUERY:
        start = perf_counter()
        single.trace_shadow(forms.for_few, query, bits, threads, counters, progress)
        choice = StrategyChoice("single", rays, "few rays", 0.0, {}, seconds=perf_counter() - start)
        memory.learn(_FEW_RAYS, choice, auto.builder)
        return
    facts = features_of(query, forms.triangles, forms.box)
    key, places = feature_key(facts), None
    suited = suitable_strategies(query, forms.box)
    if sorting_pays(query, forms, facts, suited, threads):
        places = spatial_order(query.origins[0])
        query = reorder_query(query, places)
        facts = features_of(query, forms.triangles, forms.box)
    choice = choose_strategy(query, forms, facts, suited, threads, memory.rates(key))
    auto.improve(query, choice, threads)
    form, start = auto.forms.of(STRATEGIES[choice.way]), perf_counter()
    out = bits if places is None else np.zeros_like(bits)
    STRATEGIES[choice.way].trace(form, query, out, threads, counters, progress)
    if places is not None:
        bits[:, places] = out
    memory.learn(key, choice._replace(sorted=places is not None, seconds=perf_counter() - start), auto.builder)
