"""Ray lists and cut-outs: their hits are added to those on solid triangles, in memory or in a store."""

from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from ...bvh.wide_bvh import widen
from ...query.ray_list import HitArrays, RayArguments, changed_error, hit_arrays
from ...scene.triangles import AllHits, ClosestPoints
from ...trace.alpha_cutouts import CutoutTree, add_hits, without_holes
from ...trace.closest_points import closest_points
from ...trace.rays.all_hits import INSIDE, count_all, find_all
from ...trace.rays.local_rays import local_rays
from ...trace.rays.ray_batches import RayTracer

_T = TypeVar("_T")


def of_valid(rays: RayArguments, result: _T | None) -> _T:
    """The result of tracing rays. Raises the InputError of the first invalid ray if it is None."""
    if result is None:
        rays.arrays().check()
        raise changed_error()
    return result


class CutoutHits:
    """Traces ray lists through the cut-outs of a scene."""

    def __init__(self, tree: CutoutTree, threads: int):
        self.tree, self._tracer = tree, RayTracer(widen(tree.bvh, threads))

    def add(self, rays: RayArguments, any_hit: bool, out: HitArrays, threads: int) -> None:
        """Add hits to those on solid triangles, all of which are in memory."""
        whole = hit_arrays(rays.n, True)  # most rays meet no cut-out, and need neither texels nor another list
        self._tracer.trace(rays, True, whole, threads)
        add_hits(self.tree, rays.arrays(), rays.cull_faces, any_hit, out, threads, whole.blocked)

    def all_hits(self, rays: RayArguments, rule: int, threads: int) -> AllHits:
        """All hits, with signed t, without those on texels that closest hits ignore."""
        hits = of_valid(rays, find_all(self._tracer, rays, None, rule, threads))
        return without_holes(self.tree, local_rays(rays.arrays(), rays.cull_faces), hits, threads)

    def count_hits(self, rays: RayArguments, rule: int, threads: int) -> NDArray[np.int64]:
        """(n,) int64: the number of hits of each ray. INSIDE sees no holes."""
        if rule == INSIDE:
            return of_valid(rays, count_all(self._tracer, rays, rule, threads))
        return self.all_hits(rays, rule, threads).counts

    def closest_points(self, points: NDArray[np.float32], threads: int) -> ClosestPoints:
        """The closest points, which may lie in holes."""
        return closest_points(self._tracer.tree, points, threads)
