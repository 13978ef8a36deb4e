"""The contract: when does a ray meet a triangle? Decided exactly, in real arithmetic, on float32 coordinates.

A ray is the points o + t d with tmin < t < tmax; o and the triangle's corners are float32, d is a sum of two float64
(a float32 direction, or the exact difference of a light sample and a receiver). It meets a triangle when the *line*
meets the closed triangle (edges and vertices belong to it) and the one t where it does lies strictly inside the
interval. A line in the triangle's own plane does not meet it, so a triangle without area never blocks. With a, b, c the
corners relative to o and n the triangle's normal, all follows from signs of 3 x 3 determinants:

    e0 = det(d, b, c)   e1 = det(d, c, a)   e2 = det(d, a, b)        e0 + e1 + e2 = d . n
    t = det(a, b, c) / (d . n)

All e >= 0 or all <= 0, not all zero: the line meets the triangle. Because the signs are those of the real numbers,
triangles that share an edge or a vertex see the same line on the same side of it: closed meshes cannot leak.

Here and in `filters`, `corners` is an (n, 9) float32 array, or a pointer to its first number (`simd.ptr`), which hot
kernels prefer: passing an array costs a reference count.
"""

from typing import NamedTuple

import numpy as np

from ..jit import inlined, kernel
from ..simd import get
from .expansion import CAPACITY, add_determinant, sign_of, two_diff, value_of


class Ray(NamedTuple):
    """One ray in float64: exactly the float32 input. All fields are float64 scalars."""

    ox: np.float64  # origin
    oy: np.float64
    oz: np.float64
    dx: np.float64  # direction, leading part
    dy: np.float64
    dz: np.float64
    rx: np.float64  # direction, exact remainder (zero for a direction that was given)
    ry: np.float64
    rz: np.float64
    tmin: np.float64
    tmax: np.float64


@inlined
def ray_along(ox, oy, oz, dx, dy, dz, tmin, tmax):
    """The ray of a float32 origin, a direction, and the open interval (tmin, tmax) in lengths of the direction."""
    f = np.float64
    return Ray(f(ox), f(oy), f(oz), f(dx), f(dy), f(dz), 0.0, 0.0, 0.0, f(tmin), f(tmax))


@inlined
def segment(ox, oy, oz, lx, ly, lz):
    """The ray from float32 point o to float32 point l, both ends excluded."""
    f = np.float64
    dx, rx = two_diff(f(lx), f(ox))
    dy, ry = two_diff(f(ly), f(oy))
    dz, rz = two_diff(f(lz), f(oz))
    return Ray(f(ox), f(oy), f(oz), dx, dy, dz, rx, ry, rz, 0.0, 1.0)


@kernel
def _set_direction(row, ray):
    row[0, 0], row[0, 1] = ray.dx, ray.rx
    row[1, 0], row[1, 1] = ray.dy, ray.ry
    row[2, 0], row[2, 1] = ray.dz, ray.rz


@kernel
def _set_difference(row, corners, i, corner, x, y, z):
    """row = corner - (x, y, z), exactly."""
    k = 9 * i + 3 * corner
    row[0, 0], row[0, 1] = two_diff(np.float64(get(corners, k)), x)
    row[1, 0], row[1, 1] = two_diff(np.float64(get(corners, k + 1)), y)
    row[2, 0], row[2, 1] = two_diff(np.float64(get(corners, k + 2)), z)


@kernel
def _add_normal_dot_direction(sum_, n, rows, ray, corners, i, scale):
    """Add scale * d . n = scale * det(d, v1 - v0, v2 - v0)."""
    f, k = np.float64, 9 * i
    x, y, z = f(get(corners, k)), f(get(corners, k + 1)), f(get(corners, k + 2))
    _set_direction(rows[0], ray)
    _set_difference(rows[1], corners, i, 1, x, y, z)
    _set_difference(rows[2], corners, i, 2, x, y, z)
    return add_determinant(sum_, n, rows, scale)


@kernel
def _add_volume(sum_, n, rows, x, y, z, corners, i, scale):
    """Add scale * det(a, b, c), the corners relative to the point (x, y, z)."""
    for corner in range(3):
        _set_difference(rows[corner], corners, i, corner, x, y, z)
    return add_determinant(sum_, n, rows, scale)


@kernel
def exact_line_side(ray, corners, i):
    """Sign of d . n if the line meets triangle i, else 0."""
    sum_ = np.empty(CAPACITY)
    rows = np.empty((3, 3, 2))
    _set_direction(rows[0], ray)
    side = 0
    for edge in range(3):
        _set_difference(rows[1], corners, i, (edge + 1) % 3, ray.ox, ray.oy, ray.oz)
        _set_difference(rows[2], corners, i, (edge + 2) % 3, ray.ox, ray.oy, ray.oz)
        s = sign_of(sum_, add_determinant(sum_, 0, rows, 1.0))
        if s * side < 0:
            return 0
        if s != 0:
            side = s
    return side


@kernel
def exact_meets(ray, corners, i):
    """Sign of d . n if the ray meets triangle i inside its open interval, else 0."""
    side = exact_line_side(ray, corners, i)
    if side == 0:
        return 0
    sum_ = np.empty(CAPACITY)
    rows = np.empty((3, 3, 2))
    n = _add_volume(sum_, 0, rows, ray.ox, ray.oy, ray.oz, corners, i, 1.0)
    n = _add_normal_dot_direction(sum_, n, rows, ray, corners, i, -ray.tmin)
    if sign_of(sum_, n) * side <= 0:
        return 0
    if ray.tmax < np.inf:
        n = _add_volume(sum_, 0, rows, ray.ox, ray.oy, ray.oz, corners, i, -1.0)
        n = _add_normal_dot_direction(sum_, n, rows, ray, corners, i, ray.tmax)
        if sign_of(sum_, n) * side <= 0:
            return 0
    return side


@kernel
def exact_t(ray, corners, i):
    """t of the line's point in the plane of triangle i, correct to float64's last places."""
    sum_ = np.empty(CAPACITY)
    rows = np.empty((3, 3, 2))
    volume = value_of(sum_, _add_volume(sum_, 0, rows, ray.ox, ray.oy, ray.oz, corners, i, 1.0))
    return volume / value_of(sum_, _add_normal_dot_direction(sum_, 0, rows, ray, corners, i, 1.0))


@kernel
def exact_plane_side(x, y, z, corners, i):
    """Side of the plane of triangle i on which the point lies: 1 where the normal points, -1, or 0 on the plane.

    A triangle without area has no plane: 0 everywhere.
    """
    sum_ = np.empty(CAPACITY)
    rows = np.empty((3, 3, 2))
    return -sign_of(sum_, _add_volume(sum_, 0, rows, x, y, z, corners, i, 1.0))
