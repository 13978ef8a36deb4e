"""Bounding volume hierarchies: their nodes, the methods that build them, and how good they are."""

from collections.abc import Callable
from functools import partial
from typing import NamedTuple

from . import binned_sah, lbvh, rayorder, refit, reinsertion, srdh, sweep_sah, tl_lbvh


class Builder(NamedTuple):
    """A method that builds a BVH: ``build(vertices, threads=None, ...) -> Bvh``.

    Those that want rays take `rayset.Intersections` as ``rays`` too.
    """

    build: Callable
    description: str
    paper: str
    wants_rays: bool = False


class Optimiser(NamedTuple):
    """A method that makes a finished BVH better: ``optimise(bvh, threads=None, ...) -> Bvh``.

    Those that want rays take `rayset.Intersections` as ``rays`` too.
    """

    optimise: Callable
    description: str
    paper: str
    wants_rays: bool = False


class Updater(NamedTuple):
    """A method that makes the BVH of a frame from that of the last one, where that pays.

    ``keep(build)`` gives what keeps the BVH from frame to frame: an object with ``update(vertices, threads) -> Bvh``;
    ``build(vertices, threads)`` makes a new one.
    """

    keep: Callable
    description: str
    paper: str


_FELTMAN = "Feltman et al. 2012, SRDH: Specializing BVH construction and traversal order"

BUILDERS: dict[str, Builder] = {
    "bsah": Builder(
        binned_sah.build,
        "binned surface area heuristic, top-down, in parallel",
        "Wald 2007, On fast construction of SAH-based bounding volume hierarchies",
    ),
    "sweep-sah": Builder(
        sweep_sah.build,
        "full sweep surface area heuristic: the reference of quality",
        "MacDonald and Booth 1990, Heuristics for ray tracing using space subdivision",
    ),
    "lbvh": Builder(
        lbvh.build,
        "Morton codes of 30 bits: the fastest to build",
        "Karras 2012, Maximizing parallelism in the construction of BVHs, octrees, and k-d trees",
    ),
    "lbvh63": Builder(
        lbvh.build63,
        "Morton codes of 63 bits: for scenes with fine detail in a small part",
        "Karras 2012, Maximizing parallelism in the construction of BVHs, octrees, and k-d trees",
    ),
    "tl-lbvh": Builder(
        tl_lbvh.build,
        "lbvh with its treelets restructured: as fast as bsah, and better in most scenes",
        "Karras and Aila 2013, Fast parallel construction of high-quality bounding volume hierarchies",
    ),
    "srdh": Builder(
        srdh.build,
        "built, and children ordered, for shadow rays like those of a sparse sample",
        f"{_FELTMAN}, Sec. 3.4",
        wants_rays=True,
    ),
    "srdh:distance": Builder(
        partial(srdh.build, kernels="distance"),
        "the same, each node's children front to back or back to front",
        f"{_FELTMAN}, Sec. 4.3",
        wants_rays=True,
    ),
    "srdh:all": Builder(
        partial(srdh.build, kernels="all"),
        "the same, with whatever order suits each node best",
        f"{_FELTMAN}, Sec. 4.3",
        wants_rays=True,
    ),
    "srdh:paper": Builder(
        partial(srdh.build, kernels="all", prior=0.0, linear=True, reorder=False, max_leaf=1),
        "as published: all orders, one triangle in a leaf, rays alone decide where there are any, linear costs",
        _FELTMAN,
        wants_rays=True,
    ),
}
"""Name -> builder; every one makes a correct BVH of the same form from the same triangles."""

OPTIMISERS: dict[str, Optimiser] = {
    "reinsert": Optimiser(
        reinsertion.reinsert,
        "subtrees move to where they cost less: the best trees, for twice the time of bsah and more",
        "Meister and Bittner 2018, Parallel reinsertion for bounding volume hierarchy optimization",
    ),
    "srdh-order": Optimiser(
        rayorder.order_by_rays,
        "children ordered for shadow rays like those of a sparse sample, in the tree of any other builder",
        f"{_FELTMAN}, Sec. 3.2",
        wants_rays=True,
    ),
}
"""Name -> optimiser; every one takes a BVH of any builder that wants no rays; its result costs no more by SAH."""

UPDATERS: dict[str, Updater] = {
    "refit": Updater(
        refit.Deforming,
        "the last frame's tree with new boxes, until that costs a tenth more than when it was built",
        "Lauterbach et al. 2006, RT-DEFORM: interactive ray tracing of dynamic scenes using BVHs",
    ),
}
"""Name -> updater; each works on the tree of any builder."""
