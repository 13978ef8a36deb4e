"""The wide tree of ray lists, kept while users move the geometry: refitted, or rebuilt once that pays.

Refitting takes a tenth of the time of a build, but boxes come to overlap, and rays lose time. The loss is predicted
from the SAH cost: a tree whose cost has grown by a factor g takes g times as long. The tree is rebuilt once rays have
lost as much time as the build takes (the ski-rental rule), counting those about to be traced. The total loss is then at
most about twice the minimum.
"""

from typing import NamedTuple

from ..bvh.nodes import WideBvh
from ..bvh.refit import LIMIT
from ..bvh.wide_bvh import wide_cost
from ..bvh.wide_refit import WideRefit, refit_wide, wide_refit
from ..kernels.array_pool import ArrayPool
from ..scene.triangles import Triangles
from .accelerator import Accelerated, Accelerator
from .auto.cost_model import GOOD, RAY_SECONDS, rebuild_pays
from .tree_choice import are_equal_faces


class _BuiltTree(NamedTuple):
    """A tree as it was built."""

    cost: float  # `wide_cost`
    refit: WideRefit


class RayTreeRefit:
    """Refits the wide tree of ray lists, and counts the seconds that rays lose because it was not rebuilt.

    threads : int
    """

    def __init__(self, threads: int) -> None:
        self._threads, self._pool = threads, ArrayPool()
        self.begin()

    def begin(self) -> None:
        """Begin with another tree, which has just been built."""
        self._built: _BuiltTree | None = None  # None: until it is first refitted
        self._growth = 1.0  # SAH cost of the latest tree, relative to that of the built one
        self._lost = 0.0  # seconds of all threads

    def add(self, seconds: float) -> None:
        """Count the computing time of rays in the latest tree."""
        if self._growth > LIMIT:
            self._lost += seconds * _lost_share(self._growth)

    def refit(
        self, accelerator: Accelerator, latest: Accelerated, triangles: Triangles, rays: int
    ) -> Accelerated | None:
        """The latest tree with moved triangles; None if a new one must be built.

        accelerator : of the tree's plan
        rays : number of rays that are about to be traced
        """
        wide, bvh = latest.prepared, latest.bvh
        assert isinstance(wide, WideBvh) and bvh is not None
        n = len(bvh.prim_ids)
        if n < 2 or not are_equal_faces(latest.triangles.solid, triangles.solid):
            return None
        if self._built is None:
            self._built = _BuiltTree(wide_cost(wide, self._threads), wide_refit(wide))
        built = self._built
        prepared = refit_wide(built.refit, triangles.vertices, self._threads, self._pool)
        growth = max(wide_cost(prepared, self._threads) / built.cost, 1.0)
        expected = rays * RAY_SECONDS * growth * _lost_share(growth)
        if rebuild_pays(self._lost + expected, GOOD, n):
            return None
        self._growth = growth
        return Accelerated(triangles, prepared.bvh, prepared, accelerator.cutouts_of(triangles))


def _lost_share(growth: float) -> float:
    """The share of the time of rays that a rebuild would save. Costs within LIMIT say nothing about times."""
    return 1.0 - 1.0 / growth if growth > LIMIT else 0.0
