"""Registers the papers' methods, as published or for comparison, under names that plans accept like any other.

This module defines the traversal orders ``single:...`` [Feltman et al. 2012, Sec. 3.1], the builders of Sec. 4.3, and
the tracers ``chcrt:N`` of aggressive mode [Mattausch et al. 2015, Sec. 7], which are not exact. Frusta, packets, cones
and cell marking have modules of their own.
"""

from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

from ...base.progress import ProgressCallback
from ...bvh.block_tree import block_tree
from ...bvh.child_order import order_children
from ...bvh.nodes import BACK_TO_FRONT, FRONT_TO_BACK, LEFT_FIRST, Bvh
from ...engine.method_registry import (
    FELTMAN,
    SELGRAD,
    Builder,
    Culler,
    register,
    register_family,
)
from ...kernels.toolchain import kernel_manifest
from ...query.shadow_query import ShadowQuery
from ...techniques.chcrt.chcrt_tracer import ChcRtTracer
from ...techniques.culling.pre_bvh_culling import cull
from ...techniques.rayhierarchy.cone_tracer import RayHierarchyTracer
from ...techniques.srdh import srdh_builder
from ...techniques.tracer_options import ChcRtOptions
from ...trace.frusta.multi_frusta import BENTHIN
from ...trace.rays.ray_traversal import NEAREST, RANDOM, SRDH, Ordered
from ...trace.rays.single_rays import SingleRays
from ...trace.tracer import BVH, Bits, Counters, Form, Tracer
from .multi_frusta import large_packets, moeller_trumbore, published_frusta
from .pre_bvh_culling.cell_marking import LINES
from .pre_bvh_culling.convex_region import CONVEX
from .ray_hierarchy.cone_hierarchy import CONES, find_combination

# --- Aggressive mode ``chcrt:N``: skips subtrees that few rays of a tile may hit [Mattausch et al. 2015, Sec. 7] ------


THRESHOLDS = 0, 20, 100, 200
"""A subtree is skipped if at most this many rays of a tile may hit it; 0 is exact, as `chcrt`."""


def tracer_name(threshold: int) -> str:
    """The name of the tracer with this threshold."""
    return f"chcrt:{threshold}" if threshold else "chcrt"


def find_aggressive(text: str) -> tuple[str, Tracer] | None:
    """(name, tracer) of an aggressive tracer; None for any other name."""
    for n in THRESHOLDS[1:]:
        if text == tracer_name(n):
            about = f"as chcrt, but skips subtrees that at most {n} rays of a tile may hit: not exact"
            return text, ChcRtTracer(ChcRtOptions(threshold=n), about)
    return None


# --- Traversal orders ``single:...`` and SRDH builders [Feltman et al. 2012, Sec. 3.1 and 4.3] ------------------------


def _unchanged(bvh: Bvh) -> Bvh:
    """The BVH as built, for orders that need no preparation."""
    return bvh


class TraversalOrder(NamedTuple):
    """A traversal order of any-hit rays."""

    value: int  # the order's code in `walk`
    prepare: Callable[[Bvh], Bvh]  # prepares a BVH for the order
    description: str
    paper: str


_SEC_3_1 = f"{FELTMAN}, Sec. 3.1"

ORDERS: dict[str, TraversalOrder] = {
    "random": TraversalOrder(RANDOM, _unchanged, "a random child first", _SEC_3_1),
    "left-first": TraversalOrder(LEFT_FIRST, _unchanged, "children in stored order", _SEC_3_1),
    "front-to-back": TraversalOrder(FRONT_TO_BACK, _unchanged, "the child with the closer centre first", _SEC_3_1),
    "back-to-front": TraversalOrder(BACK_TO_FRONT, _unchanged, "the child with the farther centre first", _SEC_3_1),
    "nearest": TraversalOrder(
        NEAREST, _unchanged, "the child that the ray enters first", "Ize 2013, Robust BVH ray traversal"
    ),
    "rtsah": TraversalOrder(
        LEFT_FIRST,
        order_children,
        "the child with the lower expected cost of finding a blocker first, estimated from its density",
        "Ize and Hansen 2011, RTSAH traversal order for occlusion rays",
    ),
    "srdh": TraversalOrder(
        SRDH, _unchanged, "in the order that the builder chose at each node, in any order where it chose none", _SEC_3_1
    ),
}
"""Traversal order by name."""


BUILDERS = {
    "srdh:distance": Builder(
        partial(srdh_builder.build, options=srdh_builder.SrdhOptions("distance")),
        "as srdh, but each node is traversed front to back or back to front",
        f"{FELTMAN}, Sec. 4.3",
        wants_rays=True,
    ),
    "srdh:all": Builder(
        partial(srdh_builder.build, options=srdh_builder.SrdhOptions("all")),
        "as srdh, with the best of all orders at each node",
        f"{FELTMAN}, Sec. 4.3",
        wants_rays=True,
    ),
    "srdh:paper": Builder(
        partial(srdh_builder.build, max_leaf=1, options=srdh_builder.PUBLISHED),
        "as published: all orders, one triangle per leaf, linear costs, and rays alone decide wherever there are any",
        FELTMAN,
        wants_rays=True,
    ),
}
"""Builder by name."""


class InOrder(SingleRays):
    """The tracer `single` with another traversal order."""

    cost = None

    def __init__(self, name: str, order: TraversalOrder):
        self.description, self.paper = f"as single, {order.description}", order.paper
        self.form = Form(f"ordered:{name}", lambda bvh, threads: Ordered(order.prepare(bvh), order.value))


class Published(Tracer):
    """A tracer of a paper, which traces by a function.

    trace_shadow : function of (prepared, query, bits, threads, counters, progress)
    """

    def __init__(self, form: Form, trace_shadow: Callable[..., None], description: str, paper: str):
        self.form, self.description, self.paper = form, description, paper
        self._trace_shadow = trace_shadow

    def trace(
        self,
        prepared: Any,
        query: ShadowQuery,
        bits: Bits,
        threads: int | None = None,
        counters: Counters | None = None,
        progress: ProgressCallback | None = None,
        fresh: bool = True,
    ) -> None:
        if not fresh:
            bits[...] = 0  # every segment is traced
        self._trace_shadow(prepared, query, bits, threads, counters, progress)


# --- Registration -----------------------------------------------------------------------------------------------------


NEEDS = Path(__file__).with_name("needs.json")
"""The kernels that each method calls; see `kernels.toolchain.kernel_manifest`."""

CULLERS = {
    **{
        f"grid{n}:paper": Culler(
            partial(cull, n=n, method=LINES),
            f"as grid{n}, but marks lines between cells, in a grid over the whole scene",
            SELGRAD,
        )
        for n in (32, 16, 64)
    },
    "grid32:convex": Culler(
        partial(cull, n=32, method=CONVEX),
        "as grid32, but marks a convex region around receivers and lights",
        f"{SELGRAD}, Fig. 2b",
    ),
}

_SHALLOW = Form("shallow", partial(block_tree, block=published_frusta.BLOCK))

_BENTHIN = BENTHIN.partition(",")[0]

TRACERS = {
    **{f"single:{name}": InOrder(name, order) for name, order in ORDERS.items()},
    "multifrusta:paper": Published(
        _SHALLOW,
        published_frusta.as_published,
        "16 frusta of 16 rays at once, one receiver each; corner rays cull triangles at leaves",
        f"{_BENTHIN}, Sec. 4",
    ),
    "multifrusta:leaf-boxes": Published(
        _SHALLOW,
        published_frusta.with_leaf_boxes,
        "as multifrusta:paper, plus ray-box tests at leaves",
        f"{_BENTHIN}, Sec. 5.3, Ray-AABB",
    ),
    "multifrusta:corners": Published(
        _SHALLOW,
        published_frusta.with_corners,
        "as multifrusta:paper, with corner rays that shrink to the active rays",
        f"{_BENTHIN}, Sec. 5.3, CR",
    ),
    "multifrusta:full": Published(
        _SHALLOW,
        published_frusta.with_all,
        "as multifrusta:paper, with corner rays and bounds that shrink to the active rays",
        f"{_BENTHIN}, Sec. 5.3, FS",
    ),
    "packet16:paper": Published(
        BVH,
        moeller_trumbore.trace_shadow,
        "as packet16:samples, with the triangle test of Moeller and Trumbore",
        f"{_BENTHIN}, Sec. 5",
    ),
    "packet256": Published(
        _SHALLOW,
        large_packets.trace_shadow,
        "16 packets of 16 rays together; every node tests all rays",
        f"{_BENTHIN}, Sec. 5.2",
    ),
    **{name: RayHierarchyTracer(*variant) for name, variant in CONES.items()},
}


def add() -> None:
    """Register all methods of the papers, once in a process (entry point ``antumbra.engine.method_registry``)."""
    for field, methods in ("cull", CULLERS), ("build", BUILDERS), ("trace", TRACERS):
        for name, method in methods.items():
            register(field, name, method, published=True)
    register_family("cones", find_combination)
    register_family("chcrt", find_aggressive)
    kernel_manifest.add_manifest(NEEDS)
