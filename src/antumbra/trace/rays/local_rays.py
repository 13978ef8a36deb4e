"""Rays of lists in the scene's frame, as kernels read them."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...kernels.exact.predicate import ray_along, segment
from ...kernels.jit import inlined
from ...query.ray_list import RayArrays
from ...query.ray_passes import RayPass


class LocalRays(NamedTuple):
    """Rays in the scene's frame."""

    origins: NDArray[np.float32]  # (m, 3)
    directions: NDArray[np.float32]  # (m, 3); zero: no ray; for segments, their targets
    skip: NDArray[np.int32]  # (m,), a triangle that is not tested; -1: none
    tmin: NDArray[np.float64]  # (m,)
    tmax: NDArray[np.float64]  # (m,)
    cull_faces: int = 0  # a value of `query.shadow_query.CULL_FACES`
    segments: bool = False

    def part(self, places: slice) -> "LocalRays":
        """Some of the rays."""
        ends = self.tmin[places], self.tmax[places]
        return LocalRays(
            self.origins[places], self.directions[places], self.skip[places], *ends, self.cull_faces, self.segments
        )


@inlined
def local_ray(rays, i):
    """Ray i of `LocalRays`."""
    o, d = rays.origins[i], rays.directions[i]
    if rays.segments:
        return segment(o[0], o[1], o[2], d[0], d[1], d[2])
    return ray_along(o[0], o[1], o[2], d[0], d[1], d[2], rays.tmin[i], rays.tmax[i])


def local_rays(rays: RayArrays, cull_faces: int) -> LocalRays:
    """`LocalRays` of a checked ray list."""
    origins, directions = (np.require(each, requirements="W") for each in rays.local())  # one kernel for all lists
    tmin, tmax = (np.ascontiguousarray(end[:, 0], np.float64) for end in (rays.tmin, rays.tmax))
    return LocalRays(origins, directions, rays.skip[:, 0].copy(), tmin, tmax, int(cull_faces), rays.segments)


def are_valid(rays: LocalRays) -> bool:
    """Whether `query.ray_list.RayArrays.check` accepts the rays."""
    finite = np.isfinite(rays.origins).all() and np.isfinite(rays.directions).all()
    ends = (rays.tmin >= 0.0).all() and (rays.tmin < np.inf).all() and not np.isnan(rays.tmax).any()
    return bool(finite and ends and (rays.segments or rays.directions.any(1).all()))


def local_pass(rays: RayPass) -> LocalRays:
    """`LocalRays` of a pass, over (0, inf)."""
    m = len(rays.origins)
    return LocalRays(*rays, np.zeros(m), np.full(m, np.inf))
