"""Registers the methods of the papers, as published or for comparison. Plans name them like any other method.

Defined here: traversal orders ``single:...`` [Feltman et al. 2012, Sec. 3.1] and builders (Sec. 4.3), and the tracers
``chcrt:N`` of aggressive mode [Mattausch et al. 2015, Sec. 7], which are not exact. Frusta, packets, cones and cell
marking have modules of their own.
"""

from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import NamedTuple

from ..bvh.block_tree import block_tree
from ..bvh.child_order import sooner_first
from ..bvh.nodes import BACK_TO_FRONT, FRONT_TO_BACK, LEFT_FIRST, Bvh
from ..engine.method_registry import (
    BENTHIN,
    FELTMAN,
    SELGRAD,
    Builder,
    Culler,
    Tracer,
    by_cones,
    by_culling,
    register,
    register_family,
    unchanged,
)
from ..kernels.toolchain import kernel_manifest as needs
from ..techniques.culling.pre_bvh_culling import cull
from ..techniques.srdh import srdh_builder as srdh
from ..techniques.tracer_options import ChcRtOptions
from ..trace.rays.ray_traversal import NEAREST, RANDOM, SRDH, Ordered
from ..trace.rays.single_rays import trace_shadow
from .multi_frusta import packet_baselines as packet256
from .multi_frusta import published_frusta as frusta
from .pre_bvh_culling.cell_marking import mark_convex, mark_lines
from .ray_hierarchy.cone_hierarchy import CONES, find_combination

# --- The tracers ``chcrt:N`` of the aggressive mode [Mattausch et al. 2015, Sec. 7]. They are not exact ---------------
#
# They leave out subtrees that few rays of a tile may meet.


THRESHOLDS = 0, 20, 100, 200
"""Thresholds: a subtree is neglected if at most so many rays of a tile may meet it; 0: exact, as in `chcrt`."""


def tracer_name(threshold: int) -> str:
    """The name of the tracer with this threshold."""
    return f"chcrt:{threshold}" if threshold else "chcrt"


def find_aggressive(text: str) -> tuple[str, Tracer] | None:
    """(name, tracer) of an aggressive tracer; None if the name is not one."""
    for n in THRESHOLDS[1:]:
        if text == tracer_name(n):
            about = f"as chcrt, but subtrees that at most {n} rays of a tile may meet are left out: not exact"
            return text, by_culling(ChcRtOptions(threshold=n), about)
    return None


# --- Methods of [Feltman et al. 2012]: traversal orders (Sec. 3.1), as ``single:...``, and builders (Sec. 4.3) --------


class TraversalOrder(NamedTuple):
    """A traversal order of any-hit rays."""

    value: int  # the number that `walk` takes
    prepare: Callable[[Bvh], Bvh]  # prepares a BVH for this order
    description: str
    paper: str


_SEC_3_1 = f"{FELTMAN}, Sec. 3.1"

ORDERS: dict[str, TraversalOrder] = {
    "random": TraversalOrder(RANDOM, unchanged, "either child with the same chance", _SEC_3_1),
    "left-first": TraversalOrder(LEFT_FIRST, unchanged, "the children as they are stored", _SEC_3_1),
    "front-to-back": TraversalOrder(
        FRONT_TO_BACK, unchanged, "the child whose centre is closer to the ray's origin", _SEC_3_1
    ),
    "back-to-front": TraversalOrder(BACK_TO_FRONT, unchanged, "the child whose centre is farther from it", _SEC_3_1),
    "nearest": TraversalOrder(
        NEAREST, unchanged, "the child whose box the ray enters first", "Ize 2013, Robust BVH ray traversal"
    ),
    "rtsah": TraversalOrder(
        LEFT_FIRST,
        sooner_first,
        "the child that is expected to block the ray for less work, by how dense it is",
        "Ize and Hansen 2011, RTSAH traversal order for occlusion rays",
    ),
    "srdh": TraversalOrder(
        SRDH, unchanged, "as the builder chose at each node, either child where it did not", _SEC_3_1
    ),
}
"""Name -> order."""


BUILDERS = {
    "srdh:distance": Builder(
        partial(srdh.build, kernels="distance"),
        "as srdh, each node's children front to back or back to front",
        f"{FELTMAN}, Sec. 4.3",
        wants_rays=True,
    ),
    "srdh:all": Builder(
        partial(srdh.build, kernels="all"),
        "as srdh, with whatever order suits each node best",
        f"{FELTMAN}, Sec. 4.3",
        wants_rays=True,
    ),
    "srdh:paper": Builder(
        partial(srdh.build, kernels="all", prior=0.0, linear=True, reorder=False, max_leaf=1),
        "as published: all orders, one triangle in a leaf, rays alone decide where there are any, linear costs",
        FELTMAN,
        wants_rays=True,
    ),
}
"""Name -> builder."""


def in_order(order: TraversalOrder) -> Tracer:
    """The tracer `single` with another traversal order."""

    def prepare(bvh, threads=None):
        return Ordered(order.prepare(bvh), order.value)

    return Tracer(prepare, trace_shadow, f"as single, {order.description}", order.paper, counts_apart=True)


# --- Registers the methods of the papers, as published or for comparison. Plans name them like any other method -------


NEEDS = Path(__file__).with_name("needs.json")
"""A table of the kernels that each method calls; see `kernels.toolchain.kernel_manifest`."""

CULLERS = {
    "grid32:paper": Culler(
        partial(cull, n=32, mark=mark_lines, whole=True),
        "as grid32, by lines between cells through a grid over all",
        SELGRAD,
    ),
    "grid32:convex": Culler(
        partial(cull, n=32, mark=mark_convex),
        "as grid32, but everything in a convex region around receivers and lights",
        f"{SELGRAD}, Fig. 2b",
    ),
}

_shallow = partial(block_tree, block=frusta.BLOCK)  # one object, so that its tracers can share a tree

_BENTHIN = BENTHIN.partition(",")[0]

TRACERS = {
    **{f"single:{name}": in_order(order) for name, order in ORDERS.items()},
    "multifrusta:paper": Tracer(
        _shallow,
        frusta.as_published,
        "16 frusta of 16 rays at once, one receiver each, corner rays cull at leaves",
        f"{_BENTHIN}, Sec. 4",
    ),
    "multifrusta:leaf-boxes": Tracer(
        _shallow,
        frusta.with_leaf_boxes,
        "as multifrusta:paper, with rays tested against the boxes of leaves",
        f"{_BENTHIN}, Sec. 5.3, Ray-AABB",
    ),
    "multifrusta:corners": Tracer(
        _shallow,
        frusta.with_corners,
        "as multifrusta:paper, with corner rays that shrink to the rays left",
        f"{_BENTHIN}, Sec. 5.3, CR",
    ),
    "multifrusta:full": Tracer(
        _shallow,
        frusta.with_all,
        "as multifrusta:paper, with corner rays and bounds that shrink to the rays left",
        f"{_BENTHIN}, Sec. 5.3, FS",
    ),
    "packet256": Tracer(
        _shallow,
        packet256.trace_shadow,
        "16 packets of 16 rays together, all rays tested at every node",
        f"{_BENTHIN}, Sec. 5.2",
    ),
    **{name: by_cones(*variant) for name, variant in CONES.items()},
}


def add() -> None:
    """Register all methods of the papers, once in a process (entry point ``antumbra.engine.method_registry``)."""
    for field, methods in ("cull", CULLERS), ("build", BUILDERS), ("trace", TRACERS):
        for name, method in methods.items():
            register(field, name, method)
    register_family("cones", find_combination)
    register_family("chcrt", find_aggressive)
    needs.add_manifest(NEEDS)
