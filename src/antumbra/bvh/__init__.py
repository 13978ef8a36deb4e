"""Bounding volume hierarchies: their nodes, the methods that build them, and how good they are."""

from collections.abc import Callable
from typing import NamedTuple

from . import binned_sah, lbvh, sweep_sah, tl_lbvh


class Builder(NamedTuple):
    """A method that builds a BVH: ``build(vertices, threads=None, ...) -> Bvh``."""

    build: Callable
    description: str
    paper: str


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
        "lbvh with its treelets restructured: nearly as fast, and about as good as bsah",
        "Karras and Aila 2013, Fast parallel construction of high-quality bounding volume hierarchies",
    ),
}
"""Name -> builder; every one makes a correct BVH of the same form from the same triangles."""


class Optimiser(NamedTuple):
    """A method that makes a finished BVH better: ``optimise(bvh, threads=None) -> Bvh``."""

    optimise: Callable
    description: str
    paper: str


OPTIMISERS: dict[str, Optimiser] = {}
"""Name -> optimiser; each works on the tree of any builder."""


class Updater(NamedTuple):
    """A method that makes the BVH of a frame from that of the last one, where that pays.

    ``update(last, vertices, threads, build) -> Kept``; ``last`` is the Kept of the last frame or None, and ``build()``
    makes a new BVH of the vertices.
    """

    update: Callable
    description: str
    paper: str


UPDATERS: dict[str, Updater] = {}
"""Name -> updater; each works on the tree of any builder."""
