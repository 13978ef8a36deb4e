"""Ray lists over terrain: whether the surface of a raster of heights blocks each ray, by the pyramid of `terrain_rays`.

Rays have any origin, direction and interval, unlike shadow segments. Triangles are decided by the exact predicate, so
the answers are those of the tracers of trees.
"""

import numpy as np
from numpy.typing import NDArray

from ..kernels.jit import inlined, kernel
from ..kernels.parallel import new_ticket, run, shares
from ..kernels.simd import get, put, stack_f32, stack_i64
from .rays.local_rays import LocalRays, local_ray
from .terrain_rays import TerrainTree, blocker_of, meets_square, terrain_pointers

MOST_EXTENTS = 2.0**20
"""Origins and targets of rays lie within this many extents of the grid, so that float64 resolves its squares."""

_SHARE = 256  # rays that a thread takes at a time


@inlined
def _is_ray_blocked(tree, ray, corners, last, facing):
    """Whether the surface blocks a ray. `last`: the latest blocker, which is tested first."""
    square = get(last, 0)
    if square >= 0 and meets_square(tree, ray, corners, square // tree.columns, square % tree.columns, facing):
        return True
    square = blocker_of(tree, ray, corners, facing)
    if square >= 0:
        put(last, 0, square)
    return square >= 0


@kernel
def _block_rays(ticket, tree, rays, out):
    """Worker: find which rays are blocked."""
    surface, corners, last = terrain_pointers(tree), stack_f32(18), stack_i64(1)
    for first, end in shares(ticket):
        put(last, 0, np.int64(-1))
        for i in range(first, end):
            ray = local_ray(rays, i)
            moves = ray.dx != 0.0 or ray.dy != 0.0 or ray.dz != 0.0  # an empty segment is not blocked
            out[i] = moves and _is_ray_blocked(surface, ray, corners, last, rays.cull_faces)


def blocked_rays(tree: TerrainTree, rays: LocalRays, out: NDArray[np.bool_], threads: int) -> None:
    """Write whether the surface blocks each ray to `out`, (n,) bool; no triangle is skipped."""
    run(_block_rays, threads, new_ticket(len(out), _SHARE), tree, rays, out)
