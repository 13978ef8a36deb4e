"""Culling before a BVH is built: triangles that no shadow ray can meet are dropped."""

from collections.abc import Callable
from functools import partial
from typing import NamedTuple

from .cull import cull
from .lines import mark_lines

_PAPER = (
    "Selgrad et al. 2015, Faster ray-traced shadows for hybrid rendering of fully dynamic scenes by pre-BVH culling"
)


class Culler(NamedTuple):
    """A method that drops triangles: ``cull(triangles, queries, threads) -> Culled``."""

    cull: Callable
    description: str
    paper: str


CULLERS: dict[str, Culler] = {
    f"grid{n}": Culler(partial(cull, n=n), f"a grid of {n} x {n} x {n} cells between receivers and lights", _PAPER)
    for n in (32, 16, 64, 128, 256)
}
CULLERS["grid32:paper"] = Culler(
    partial(cull, n=32, mark=mark_lines, whole=True), "the same, by lines between cells through a grid over all", _PAPER
)
"""Name -> culler; every one keeps each triangle that a shadow ray of the queries can meet."""
