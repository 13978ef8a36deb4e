"""Receivers: surface points moved off their surface, once, before any method sees them.

Self-intersection is settled here. A receiver is shifted along its geometric normal, towards the side that is seen, by
a few units in the last place of its coordinates: an amount derived from the float32 error of the position itself and
of its triangle's corners, never a scene constant. If that does not bring it strictly to the seen side of its own
triangle's plane, in exact arithmetic, the shift doubles until it does. From there its own triangle cannot meet a
segment to a light sample above the same plane, and a sample that is not above is occluded by the surface itself.
"""

import numpy as np

from ..jit import kernel
from ..parallel import CHUNK, N, new_ticket, run, take, thread_count
from ..predicate.filters import plane_side

NOTHING, FREE = 0, 2  # values of `sides` besides 1 and -1: no receiver; a point without a surface

_SHIFT = np.float64(2.0**-21)  # eight units of float32 roundoff: rounding of position and normal, and of neighbours
_MAX_DOUBLINGS = 60  # a triangle without area has no side; it is never seen, but the loop must end


@kernel
def _magnitude(corners, face):
    m = np.float32(0.0)
    for k in range(9):
        m = max(m, abs(corners[face, k]))
    return np.float64(m)


@kernel
def moved_off(x, y, z, nx, ny, nz, side, corners, face, shift):
    """The float32 receiver of surface point (x, y, z) with unit normal n (towards the seen side of `face`), shifted by
    at least `shift`; all float64."""
    f = np.float32
    for _ in range(_MAX_DOUBLINGS):
        ox, oy, oz = f(x + shift * nx), f(y + shift * ny), f(z + shift * nz)
        if plane_side(ox, oy, oz, corners, face) == side:
            break
        shift *= 2.0
    return ox, oy, oz


@kernel
def _move_kernel(ticket, positions, normals, faces, sides, corners, origins):
    first = take(ticket)
    while first >= 0:
        for i in range(first, min(first + ticket[CHUNK], ticket[N])):
            side, face = sides[i], faces[i]
            x, y, z = np.float64(positions[i, 0]), np.float64(positions[i, 1]), np.float64(positions[i, 2])
            if side == NOTHING:
                origins[i, 0], origins[i, 1], origins[i, 2] = (
                    positions[i, 0],
                    positions[i, 1],
                    positions[i, 2],
                )
                continue
            nx, ny, nz = np.float64(normals[i, 0]), np.float64(normals[i, 1]), np.float64(normals[i, 2])
            shift = _SHIFT * max(max(abs(x), abs(y), abs(z)), _magnitude(corners, face))
            origins[i, 0], origins[i, 1], origins[i, 2] = moved_off(x, y, z, nx, ny, nz, side, corners, face, shift)
        first = take(ticket)


def surface_receivers(positions, normals, faces, sides, corners, threads=None) -> np.ndarray:
    """(m, 3) float32: the receivers of m points on known triangles.

    positions, normals : (m, 3) float32; normals of unit length towards the seen side
    faces : (m,) int32 triangle indices; sides : (m,) int8 seen side of the triangle's plane, NOTHING to leave out
    corners : (n, 9) float32
    """
    origins = np.empty_like(positions)
    ticket = new_ticket(len(positions), 8192)
    run(_move_kernel, thread_count(threads), ticket, positions, normals, faces, sides, corners, origins)
    return origins


def point_receivers(points, normals, world, single: bool) -> np.ndarray:
    """(m, 3) float32: the receivers of points that lie on surfaces known by their normals only.

    points : (m, 3) float64, recentred; normals : (m, 3) float64, unit length
    world : (m, 3) float64 world positions; `single` says they came as float32, so their own error counts
    """
    shift = _SHIFT * np.abs(points).max(-1, keepdims=True)
    if single:
        shift = shift + _SHIFT / 4 * np.abs(world).max(-1, keepdims=True)
    return np.ascontiguousarray((points + shift * normals).astype(np.float32))
