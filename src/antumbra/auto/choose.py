"""Chooses a way for a query: predicted costs say which ways may be best, and a sample of the rays decides among them.

Short queries are not worth a sample. Later queries of like facts take the way that was fastest.
"""

from math import ceil, log2
from time import perf_counter
from typing import NamedTuple

import numpy as np

from ..query.shadow_query import ShadowQuery, ray_count
from ..trace.light_table import STRATA
from .facts import Facts, if_sorted, size_of
from .rates import GOOD, form_seconds, lost_share, rate
from .sample import halves_of, sample_of, tile_of
from .ways import WAYS, Forms, answer

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


class Choice(NamedTuple):
    """The way that answered a query, and the reason."""

    way: str
    rays: int
    reason: str  # "prediction", "sample" or "earlier query"
    predicted: float  # seconds, for the reason
    tried: dict[str, float]  # way -> nanoseconds a ray of the sample; empty if there was none
    sorted: bool = False  # the receivers were put in order first
    seconds: float = 0.0  # measured


class Memory:
    """The rates that queries had in this frame and in earlier ones. Queries of like facts share them.

    lost : float
        Seconds that all queries so far would have been faster in a tree of GOOD.
    in_good : float
        Seconds that queries took in trees of GOOD.
    """

    def __init__(self):
        self._rates: dict[tuple, tuple[int, dict[str, float]]] = {}  # with the frame in which they were tried
        self._frame = 0
        self.choices: list[Choice] = []
        self.lost = self.in_good = 0.0

    def begin(self) -> None:
        """Begin a frame."""
        self._frame += 1
        self.choices = []

    def rates(self, key: tuple) -> dict[str, float]:
        """Way -> nanoseconds a ray, of earlier queries."""
        tried, rates = self._rates.get(key, (-_AGAIN, {}))
        return rates if self._frame - tried < _AGAIN else {}

    def learn(self, key: tuple, choice: Choice, tree: str | None) -> None:
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


def likeness(facts: Facts) -> tuple:
    """Equal for facts that differ little."""
    sizes = (round(2.0 * log2(size)) for size in (facts.tile, facts.stratum, facts.chunk))
    return facts.kind, facts.samples, facts.receivers.bit_length(), *sizes


def choose(
    query: ShadowQuery, forms: Forms, facts: Facts, suited: list[str], threads: int, known: dict[str, float]
) -> Choice:
    """Choose the way for a query.

    suited : the ways that can answer it
    known : way -> nanoseconds a ray, of earlier queries; empty: not known
    """
    made = {name: form_seconds(name, facts.triangles) * forms.missing(WAYS[name]) for name in suited}
    if known:
        cost = {name: 1e-9 * known[name] * facts.rays + made[name] for name in suited if name in known}
        way = min(cost, key=cost.__getitem__)
        return Choice(way, facts.rays, "earlier query", cost[way], {})
    cost = {name: rate(name, facts) * facts.rays / threads + made[name] for name in suited}
    way = min(cost, key=cost.__getitem__)
    likely = worth_trying(cost, made)
    if len(likely) == 1:
        return Choice(way, facts.rays, "prediction", cost[way], {})
    tried = try_ways(query, forms, likely, facts, cost[way] / max(facts.rays, 1), threads)
    way = min(tried, key=tried.__getitem__)
    return Choice(way, facts.rays, "sample", 1e-9 * tried[way] * facts.rays, tried)


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


def sorting_pays(query: ShadowQuery, forms: Forms, facts: Facts, suited: list[str], threads: int) -> bool:
    """Will the rays of scattered receivers gain what it costs to sort them in space?"""
    if query.sides.shape[0] > 1 or facts.receivers < _FEW:
        return False
    near = if_sorted(query, facts, size_of(forms.box))
    cost, sorted_cost = (min(rate(way, each) for way in suited) * facts.rays / threads for each in (facts, near))
    return sorted_cost + _SORT * facts.receivers < _SURELY * cost


def suited_ways(query: ShadowQuery, box: np.ndarray) -> list[str]:
    """The names of the ways that can answer a query; `box`: around the triangles."""
    return [name for name, way in WAYS.items() if way.suits(query, box)]


def try_ways(query, forms: Forms, ways: list[str], facts: Facts, of_ray: float, threads: int) -> dict[str, float]:
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


def sampled_rate(way: str, forms: Forms, query: ShadowQuery, threads: int) -> float:
    """Nanoseconds a ray of a way, on a sample of the query."""
    receivers = int(np.count_nonzero(query.sides))
    return _rate_of(way, forms, _sample(query, receivers, _WINDOWS), threads)


def _rate_of(way: str, forms: Forms, query: ShadowQuery, threads: int) -> float:
    """Nanoseconds a ray of a way, on the faster half of the query. A single window may take as long as all others.

    The first call of a process loads kernels, so a few rays go before.
    """
    answer(way, forms, tile_of(query), threads)
    rates = []
    for half in halves_of(query):
        start = perf_counter()
        answer(way, forms, half, threads)
        rates.append(1e9 * (perf_counter() - start) / max(ray_count(half), 1))
    return min(rates)
