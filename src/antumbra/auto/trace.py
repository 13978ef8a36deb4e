"""The tracer `auto`: it answers each query in the way that should be fastest."""

from collections.abc import Callable
from time import perf_counter

import numpy as np

from ..bvh.nodes import Bvh
from ..kernels.parallel import thread_count
from ..query.shadow_query import ShadowQuery
from ..trace.rays import single_rays as single
from .choose import Choice, Memory, choose, likeness, sampled_rate, sorting_pays, suited_ways
from .facts import facts_of
from .order import in_order, sorted_places
from .rates import GOOD, better_seconds, lost_in_quick
from .ways import WAYS, Forms

_FEW = 256  # rays that take less time than a choice
_FEW_RAYS = ("few",)  # like no other queries
_DOUBT = 16.0  # predictions from counts alone, for a reference machine, may be wrong by this factor


class Auto:
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
        self, bvh: Bvh, threads: int | None = None, memory: Memory | None = None, builder: str | None = None,
        better: Callable[[], Bvh] | None = None,
    ):  # fmt: skip
        self.forms, self.memory, self.builder = Forms(bvh, thread_count(threads)), memory or Memory(), builder
        self._better = better

    def begin(self) -> None:
        """Begin a frame, or a query of points."""
        self.memory.begin()

    def improve(self, query: ShadowQuery, choice: Choice, threads: int) -> None:
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
            self.forms, self.builder, self._better = Forms(self._better(), self.forms.threads), GOOD, None

    @property
    def choices(self) -> list[Choice]:
        """The choices of this frame, one for each query."""
        return self.memory.choices


def trace_shadow(auto: Auto, query: ShadowQuery, bits, threads=None, counters=None, progress=None) -> None:
    """Answer a ShadowQuery: set bit s of ``bits[y, x]`` where sample s is occluded.

    bits : (h, w, ceil(spp / 64)) uint64, zeros on entry
    counters : from `new_counters`, or None
    """
    threads, forms, memory = thread_count(threads), auto.forms, auto.memory
    rays = query.sides.size * query.samples.shape[1]
    if rays <= _FEW:
        start = perf_counter()
        single.trace_shadow(forms.for_few, query, bits, threads, counters, progress)
        choice = Choice("single", rays, "few rays", 0.0, {}, seconds=perf_counter() - start)
        memory.learn(_FEW_RAYS, choice, auto.builder)
        return
    facts = facts_of(query, forms.triangles, forms.box)
    key, places = likeness(facts), None
    suited = suited_ways(query, forms.box)
    if sorting_pays(query, forms, facts, suited, threads):
        places = sorted_places(query.origins[0])
        query = in_order(query, places)
        facts = facts_of(query, forms.triangles, forms.box)
    choice = choose(query, forms, facts, suited, threads, memory.rates(key))
    auto.improve(query, choice, threads)
    form, start = auto.forms.of(WAYS[choice.way]), perf_counter()
    out = bits if places is None else np.zeros_like(bits)
    WAYS[choice.way].trace(form, query, out, threads, counters, progress)
    if places is not None:
        bits[:, places] = out
    memory.learn(key, choice._replace(sorted=places is not None, seconds=perf_counter() - start), auto.builder)
