"""Tracers: they answer a ShadowQuery over a BVH, all with the same bits."""

from collections.abc import Callable
from typing import NamedTuple

from ..bvh.blocks import block_tree
from ..bvh.wide import widen
from . import multifrusta
from .single import trace_shadow


class Tracer(NamedTuple):
    """A way to answer a shadow query.

    ``prepare(bvh, threads)`` makes what it traces, once a tree; ``trace(prepared, query, bits, threads, counters,
    progress)`` answers.
    """

    prepare: Callable
    trace: Callable
    description: str
    paper: str


def as_it_is(bvh, threads=None):
    """What tracers prepare that walk the builder's own tree."""
    return bvh


TRACERS: dict[str, Tracer] = {
    "single": Tracer(
        as_it_is,
        trace_shadow,
        "one ray at a time, children nearest first, the last blocker tried first",
        "Ize 2013, Robust BVH ray traversal",
    ),
    "wide": Tracer(
        widen,
        trace_shadow,
        "one ray at a time, eight boxes or triangles side by side",
        "Ylitie et al. 2017, Efficient incoherent ray traversal on GPUs through compressed wide BVHs",
    ),
    "multifrusta": Tracer(
        block_tree,
        multifrusta.trace_shadow,
        "16 shafts of shadow rays at once, rays only where shafts do not decide",
        "Benthin and Wald 2009, Efficient ray traced soft shadows using multi-frusta tracing",
    ),
}
