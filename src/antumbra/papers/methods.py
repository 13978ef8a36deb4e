"""Registers the methods of the papers, as published or for comparison. Plans name them like any other method."""

from functools import partial
from pathlib import Path

from ..bvh.blocks import block_tree
from ..kernels import needs
from ..methods import BENTHIN, SELGRAD, Culler, Tracer, by_cones, register, register_family
from ..techniques.culling.pre_bvh_culling import cull
from .chc_rt.variants import find_aggressive
from .multi_frusta import frusta, packet256
from .pre_bvh_culling.convex import mark_convex
from .pre_bvh_culling.lines import mark_lines
from .ray_hierarchy.variants import CONES, find_combination
from .srdh.variants import BUILDERS, ORDERS, in_order

NEEDS = Path(__file__).with_name("needs.json")
"""A table of the kernels that each method calls; see `kernels.needs`."""

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
    """Register all methods of the papers, once in a process (entry point ``antumbra.methods``)."""
    for field, methods in ("cull", CULLERS), ("build", BUILDERS), ("trace", TRACERS):
        for name, method in methods.items():
            register(field, name, method)
    register_family("cones", find_combination)
    register_family("chcrt", find_aggressive)
    needs.add(NEEDS)
