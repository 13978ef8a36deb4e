"""Tracers: they answer a ShadowQuery, over a BVH or from the triangles themselves, all with the same bits."""

from collections.abc import Callable
from typing import NamedTuple

from ..bvh.blocks import block_tree
from ..bvh.widen import widen
from ..chcrt.options import CHCRT
from ..rayhierarchy.options import CONES, combination
from . import multifrusta, packet16, packet256, paperfrusta
from .orders import BUILT, ORDERS, Ordered
from .single import trace_shadow


class Tracer(NamedTuple):
    """A way to answer a shadow query.

    ``prepare(bvh, threads)`` makes what it traces, once a tree; ``trace(prepared, query, bits, threads, counters,
    progress)`` answers. Those that walk no BVH prepare a `rayhierarchy.soup.Soup` instead.
    """

    prepare: Callable
    trace: Callable
    description: str
    paper: str
    builds: bool = True  # does it walk a BVH?
    keeps: bool = False  # does what it prepares remember what was visible? Then it has `begin()`, for each frame
    exact: bool = True  # does it give the same bits as all others?
    counts_apart: bool = False  # has it kernels that count, and others that do not?


def as_it_is(made, threads=None):
    """What tracers prepare that walk the builder's own tree, or take the triangles as they are."""
    return made


def _as_built(bvh, threads=None):
    return Ordered(bvh, BUILT)


def _in_order(order):
    """The `prepare` of `single` with a traversal order."""
    return lambda bvh, threads=None: Ordered(order.prepare(bvh), order.value)


def _by_cones(options, description):
    """A tracer of the family `cones`."""

    def trace(*arguments):  # looked up late: kernels of the ray hierarchy use parts of this package
        from ..rayhierarchy.trace import trace_shadow

        trace_shadow(*arguments, options)

    return Tracer(as_it_is, trace, description, _OLSSON, builds=False)


def _by_culling(options, description):
    """A tracer of the family `chcrt`."""

    def prepare(bvh, threads=None):  # looked up late: it uses parts of this package
        from ..chcrt.trace import prepare

        return prepare(bvh, options, threads)

    def trace(*arguments):
        from ..chcrt.trace import trace_shadow

        trace_shadow(*arguments)

    return Tracer(prepare, trace, description, _MATTAUSCH, keeps=True, exact=options.threshold == 0)


_MATTAUSCH = "Mattausch et al. 2015, CHC+RT: coherent hierarchical culling for ray tracing"
_OLSSON = "Olsson and Assarsson 2011, Improved ray hierarchy alias free shadows"

TRACERS: dict[str, Tracer] = {
    "single": Tracer(
        _as_built,
        trace_shadow,
        "one ray at a time, children as the builder ordered them, else nearest first; the last blocker tried first",
        "Ize 2013, Robust BVH ray traversal",
        counts_apart=True,
    ),
    **{
        f"single:{name}": Tracer(
            _in_order(order), trace_shadow, f"the same, {order.description}", order.paper, counts_apart=True
        )
        for name, order in ORDERS.items()
    },
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
    "packet16": Tracer(
        as_it_is,
        packet16.over_pixels,
        "packets of 16 rays, from 16 receivers to a stratum of the light",
        "Benthin and Wald 2009, Sec. 5.1; Wald et al. 2001, Interactive rendering with coherent ray tracing",
    ),
    "packet16:samples": Tracer(
        as_it_is,
        packet16.over_samples,
        "packets of 16 rays, from one receiver to its samples",
        "Benthin and Wald 2009, Sec. 5.1",
    ),
    "multifrusta:paper": Tracer(
        block_tree,
        paperfrusta.as_published,
        "16 frusta of 16 rays at once, one receiver each, corner rays cull at leaves",
        "Benthin and Wald 2009, Sec. 4",
    ),
    "multifrusta:leaf-boxes": Tracer(
        block_tree,
        paperfrusta.with_leaf_boxes,
        "the same, with rays tested against the boxes of leaves",
        "Benthin and Wald 2009, Sec. 5.3, Ray-AABB",
    ),
    "multifrusta:corners": Tracer(
        block_tree,
        paperfrusta.with_corners,
        "the same, with corner rays that shrink to the rays left",
        "Benthin and Wald 2009, Sec. 5.3, CR",
    ),
    "multifrusta:full": Tracer(
        block_tree,
        paperfrusta.with_all,
        "the same, with corner rays and bounds that shrink to the rays left",
        "Benthin and Wald 2009, Sec. 5.3, FS",
    ),
    "packet256": Tracer(
        block_tree,
        packet256.trace_shadow,
        "16 packets of 16 rays together, all rays tested at every node",
        "Benthin and Wald 2009, Sec. 5.2",
    ),
    **{name: _by_cones(*method) for name, method in CONES.items()},
    "chcrt": _by_culling(*CHCRT["chcrt"]),
}
"""Name -> tracer; besides, options of `cones` can be combined at will, and `chcrt` can be told to neglect what few rays
see, as `chcrt:20` (`find_tracer`)."""


def find_tracer(text: str) -> tuple[str, Tracer] | None:
    """A tracer and what it is called: as in TRACERS, or options of `cones` in the order they have there.

    None if there is no such tracer.

    Raises
    ------
    InputError
        On options that exclude each other.
    """
    if text in TRACERS:
        return text, TRACERS[text]
    if text in CHCRT:
        return text, _by_culling(*CHCRT[text])
    options = combination(text)
    if options is None:
        return None
    family, *words = text.split(":")
    words.sort(key=lambda word: list(CONES).index(f"{family}:{word}"))
    return ":".join((family, *words)), _by_cones(options, "a combination of options")
