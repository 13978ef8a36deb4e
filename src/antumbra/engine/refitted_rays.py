"""The wide tree of ray lists, kept while users move the geometry: refitted, or rebuilt once that pays.

Refitting takes a tenth of the time of a build, but boxes come to overlap, and rays lose time. The loss is predicted
from the SAH cost: a tree whose cost has grown by a factor g takes g times as long. The tree is rebuilt once rays have
lost as much time as the build takes (the ski-rental rule), counting those about to be traced. The total loss is then at
most about twice the minimum.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..bvh.nodes import WideBvh
from ..bvh.refit import LIMIT
from ..bvh.wide_bvh import wide_cost
from ..bvh.wide_refit import MovedVertices, WideRefit, refit_wide, vertices_of_slots, wide_refit
from ..kernels.array_pool import ArrayPool
from ..scene.indexed_triangles import IndexedTriangles, padded_rows
from ..scene.triangles import Triangles
from .accelerator import Accelerated, Accelerator
from .auto.cost_model import GOOD, RAY_SECONDS, rebuild_pays
from .tree_choice import are_equal_faces


class _BuiltTree(NamedTuple):
    """A tree as it was built."""

    cost: float  # `wide_cost`
    refit: WideRefit
    solid: NDArray[np.int32] | None  # its triangles, as `Triangles.solid`


class _Numbering(NamedTuple):
    """The vertices of the triangles in the slots of a tree, for faces that `update` has used."""

    faces: NDArray[np.int32] | None  # as in `IndexedVertices`
    of_slots: NDArray[np.int32]  # see `vertices_of_slots`


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
        self._numbering: _Numbering | None = None  # the latest one; None: none so far
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
        if n < 2:
            return None
        if self._built is None:
            self._built = _BuiltTree(wide_cost(wide, self._threads), wide_refit(wide), latest.triangles.solid)
        built = self._built
        later = triangles if isinstance(triangles, IndexedTriangles) and triangles.cutouts is None else None
        finds_areas = later is not None and built.solid is None  # then the refit does
        if not finds_areas and not are_equal_faces(built.solid, triangles.solid):
            return None
        moved = refit_wide(built.refit, self._vertices_of(triangles), self._threads, self._pool)
        if finds_areas and not moved.all_have_area:
            return None
        growth = max(moved.cost / built.cost, 1.0)
        expected = rays * RAY_SECONDS * growth * _lost_share(growth)
        if rebuild_pays(self._lost + expected, GOOD, n):
            return None
        if finds_areas and later is not None:
            later.mark_solid()
        self._growth = growth
        return Accelerated(triangles, moved.wide.bvh, moved.wide, accelerator.cutouts_of(triangles))

    def _vertices_of(self, triangles: Triangles) -> MovedVertices:
        """The vertices in the slots of the tree."""
        assert self._built is not None
        if isinstance(triangles, IndexedTriangles):
            positions, faces = triangles.indexed
        else:
            positions, faces = padded_rows(3 * len(triangles.vertices), self._pool), None
            positions[:] = triangles.vertices.reshape(-1, 3)
        if self._numbering is None or self._numbering.faces is not faces:
            self._numbering = _Numbering(faces, vertices_of_slots(self._built.refit.wide, faces))
        return MovedVertices(positions, self._numbering.of_slots)


def _lost_share(growth: float) -> float:
    """The share of the time of rays that a rebuild would save. Costs within LIMIT say nothing about times."""
    return 1.0 - 1.0 / growth if growth > LIMIT else 0.0
