"""Ray lists over terrain: any or the nearest hit with the surface of a raster of heights, by `terrain_rays`.

Rays have any origin, direction and interval, unlike shadow segments. Triangles are decided by the exact predicate, and
nearest hits by the numbers of all other tracers, so the answers are theirs.
"""

import numpy as np
from numpy.typing import NDArray

from ...kernels.exact.filters import rounded_t, single_weights
from ...kernels.jit import inlined, kernel
from ...kernels.parallel import new_ticket, run, shares
from ...kernels.simd import get, ptr, put, stack_f32, stack_f64, stack_i64
from ...query.ray_list import HitArrays
from ..rays.local_rays import LocalRays, local_ray
from .terrain_rays import NearestHit, TerrainTree, find_square, meets_square, terrain_pointers

MOST_EXTENTS = 2.0**20
"""Origins and targets of rays lie within this many extents of the grid, so that float64 resolves its squares."""

_SHARE = 256  # rays that a thread takes at a time


@inlined
def _is_blocked(tree, ray, corners, last, facing):
    """Whether the surface blocks a ray. `last`: the latest blocker, which is tested first."""
    square = get(last, 0)
    if square >= 0 and meets_square(tree, ray, corners, square // tree.columns, square % tree.columns, facing):
        return True
    square = find_square(tree, ray, corners, facing, None)
    if square >= 0:
        put(last, 0, square)
    return square >= 0


@inlined
def _write_nearest(tree, ray, corners, nearest, facing, out, i):
    """Write the nearest hit of ray i."""
    put(nearest.face, 0, np.int64(-1))
    find_square(tree, ray, corners, facing, nearest)
    face = get(nearest.face, 0)
    out.face[i], out.t[i], out.u[i], out.v[i] = face, np.inf, 0.0, 0.0
    if face >= 0:
        out.t[i] = rounded_t(ray, corners, 2)
        out.u[i], out.v[i] = single_weights(ray, corners, 2)


@kernel
def _trace_rays(ticket, tree, squares, rays, any_hit, out):
    """Worker: find whether rays are blocked, or their nearest hits."""
    surface, corners, last = terrain_pointers(tree), stack_f32(27), stack_i64(1)
    nearest = NearestHit(stack_f64(1), stack_i64(1), ptr(squares))
    for first, end in shares(ticket):
        put(last, 0, np.int64(-1))
        for i in range(first, end):
            ray = local_ray(rays, i)
            if not any_hit:
                _write_nearest(surface, ray, corners, nearest, rays.cull_faces, out, i)
                continue
            moves = ray.dx != 0.0 or ray.dy != 0.0 or ray.dz != 0.0  # an empty segment is not blocked
            out.blocked[i] = moves and _is_blocked(surface, ray, corners, last, rays.cull_faces)


def trace_rays(
    tree: TerrainTree, squares: NDArray[np.int32] | None, rays: LocalRays, out: HitArrays, threads: int
) -> None:
    """Write whether the surface blocks each ray, or its nearest hit; no triangle is skipped.

    squares : (rows - 1, columns - 1), as from `scene.terrain.faces_of_squares`; None: any hit
    """
    any_hit, table = squares is None, np.empty((0, 0), np.int32) if squares is None else squares
    run(_trace_rays, threads, new_ticket(len(rays.origins), _SHARE), tree, table, rays, any_hit, out)
