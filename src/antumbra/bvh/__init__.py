"""Bounding volume hierarchies: their nodes, the methods that build them, and how good they are."""

from collections.abc import Callable
from typing import NamedTuple

from . import binned_sah


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
}
"""Name -> builder; every one makes a correct BVH of the same form from the same triangles."""
