"""The tracer `auto`: it answers each query in the way that should be fastest."""

from time import perf_counter

import numpy as np

from ..bvh.nodes import Bvh
from ..kernels.parallel import thread_count
from ..query.shadow import ShadowQuery
from .choose import Choice, Memory, choose, likeness, sorting_pays, suited_ways
from .facts import facts_of
from .order import in_order, sorted_places
from .ways import WAYS, Forms


class Auto:
    """A tree, and what its questions have measured.

    bvh : Bvh
    threads : int
    memory : Memory
        Outlives the tree in a sequence of frames.
    builder : str or None
        Name of the tree's builder, if it was chosen, too.
    """

    def __init__(self, bvh: Bvh, threads: int | None = None, memory: Memory | None = None, builder: str | None = None):
        self.forms, self.memory, self.builder = Forms(bvh, thread_count(threads)), memory or Memory(), builder

    def begin(self) -> None:
        """Begin a frame, or a query of points."""
        self.memory.begin()

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
    facts = facts_of(query, forms.triangles, forms.box)
    key, places = likeness(facts), None
    suited = suited_ways(query, forms.box)
    if sorting_pays(query, forms, facts, suited, threads):
        places = sorted_places(query.origins[0])
        query = in_order(query, places)
        facts = facts_of(query, forms.triangles, forms.box)
    choice = choose(query, forms, facts, suited, threads, memory.rates(key))
    form, start = forms.of(WAYS[choice.way]), perf_counter()
    out = bits if places is None else np.zeros_like(bits)
    WAYS[choice.way].trace(form, query, out, threads, counters, progress)
    if places is not None:
        bits[:, places] = out
    memory.learn(key, choice._replace(sorted=places is not None, seconds=perf_counter() - start))
