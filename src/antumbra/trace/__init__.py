"""Tracers: they answer a ShadowQuery over a BVH, all with the same bits."""

from collections.abc import Callable
from typing import NamedTuple

from .single import trace_shadow


class Tracer(NamedTuple):
    """A way to answer a shadow query: ``trace(bvh, query, bits, threads, counters, progress)``."""

    trace: Callable
    description: str
    paper: str


TRACERS: dict[str, Tracer] = {
    "single": Tracer(
        trace_shadow,
        "one ray at a time, children nearest first, the last blocker tried first",
        "Ize 2013, Robust BVH ray traversal",
    ),
}
