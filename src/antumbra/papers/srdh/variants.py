"""Methods of [Feltman et al. 2012]: traversal orders (Sec. 3.1), as ``single:...``, and builders (Sec. 4.3)."""

from collections.abc import Callable
from functools import partial
from typing import NamedTuple

from ...bvh import srdh
from ...bvh.nodes import BACK_TO_FRONT, FRONT_TO_BACK, LEFT_FIRST, Bvh
from ...bvh.order import sooner_first
from ...methods import FELTMAN, Builder, Tracer, unchanged
from ...trace.rays.ray_traversal import NEAREST, RANDOM, SRDH, Ordered
from ...trace.rays.single_rays import trace_shadow


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
