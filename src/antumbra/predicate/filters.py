"""Fast answers with a proven error bound: float32 first, then float64, then the exact predicate.

One body serves both precisions. With u the unit roundoff (2**-24 or 2**-53), a = v0 - o, p = v1 - v0, q = v2 - v0,

    r = d x a    e2 = p . r    e1 = -q . r    n = p x q    D = d . n    e0 = D - e1 - e2    T = a . n

Every component of d, a, p, q is one rounded difference (relative error u). A product of three of them inside a sum of
six carries at most 3 (inputs) + 1 + 1 (products) + 1 + 2 (sums) = 8 factors (1 + u), and the six products sum to at most
2 |d|_1 |a|_inf |p|_inf, so to first order

    |error e1|, |error e2| <= 16 u |d|_1 m s      |error D| <= 16 u |d|_1 s s      |error T| <= 16 u |a|_1 s s

with m = |a|_inf and s the largest component of p and q. e0 adds three such errors and two roundings (at most
10 u |d|_1 s max(m, s)), so 60 u |d|_1 s max(m, s) bounds the error of each e. ``_FACTOR`` = 20 leaves room for the second
order, for the rounding of the bounds themselves and of the comparisons with tmin and tmax. An absolute term covers
underflow. Overflow makes bounds infinite or values NaN: the comparisons below then answer UNSURE.
"""

from typing import NamedTuple

import numpy as np

from ..jit import kernel
from .exact import exact_meets, exact_plane_side, exact_t

MISS, UNSURE = 0, 2  # a hit is the sign of d . n: 1 or -1

_FACTOR = 20.0
_U32, _U64 = np.float32(_FACTOR * 2.0**-24), np.float64(_FACTOR * 2.0**-53)
_TINY32, _TINY64 = np.float32(1e-37), np.float64(1e-300)
_T_ACCURACY = np.float64(2.0**-30)  # relative accuracy of `hit_t`, relied on by the traversal's culling


class Volumes(NamedTuple):
    """The determinants of a line and a triangle, and bounds of their errors. One float type throughout."""

    e0: float
    e1: float
    e2: float
    t: float  # det(a, b, c)
    d: float  # d . n
    e_error: float  # of each of e0, e1, e2
    t_error: float
    d_error: float


@kernel
def _volumes(d, a, p, q, u, tiny):
    dx, dy, dz = d
    ax, ay, az = a
    px, py, pz = p
    qx, qy, qz = q
    rx, ry, rz = dy * az - dz * ay, dz * ax - dx * az, dx * ay - dy * ax
    nx, ny, nz = py * qz - pz * qy, pz * qx - px * qz, px * qy - py * qx
    e2 = px * rx + py * ry + pz * rz
    e1 = -(qx * rx + qy * ry + qz * rz)
    det = dx * nx + dy * ny + dz * nz
    e0 = det - e1 - e2
    volume = ax * nx + ay * ny + az * nz
    d1 = abs(dx) + abs(dy) + abs(dz)
    m = max(abs(ax), abs(ay), abs(az))
    s = max(max(abs(px), abs(py), abs(pz)), max(abs(qx), abs(qy), abs(qz)))
    floor = tiny * (d1 + m + s) + tiny
    three_u = u + u + u  # of the right float type
    e_error = three_u * d1 * s * max(m, s) + floor
    return Volumes(e0, e1, e2, volume, det, e_error, three_u * m * s * s + floor, u * d1 * s * s + floor)


@kernel
def volumes32(o, d, corners, i):
    """`Volumes` in float32: o, d are tuples of three float32 (d rounded once), corners (n, 9) float32."""
    x, y, z = corners[i, 0], corners[i, 1], corners[i, 2]
    a = (x - o[0], y - o[1], z - o[2])
    p = (corners[i, 3] - x, corners[i, 4] - y, corners[i, 5] - z)
    q = (corners[i, 6] - x, corners[i, 7] - y, corners[i, 8] - z)
    return _volumes(d, a, p, q, _U32, _TINY32)


@kernel
def volumes64(ray, corners, i):
    """`Volumes` in float64, of the leading part of the ray's direction."""
    f = np.float64
    x, y, z = f(corners[i, 0]), f(corners[i, 1]), f(corners[i, 2])
    a = (x - ray.ox, y - ray.oy, z - ray.oz)
    p = (f(corners[i, 3]) - x, f(corners[i, 4]) - y, f(corners[i, 5]) - z)
    q = (f(corners[i, 6]) - x, f(corners[i, 7]) - y, f(corners[i, 8]) - z)
    return _volumes((ray.dx, ray.dy, ray.dz), a, p, q, _U64, _TINY64)


@kernel
def line_verdict(w):
    """Does the line meet the closed triangle? The sign of d . n, MISS, or UNSURE."""
    low = min(w.e0, min(w.e1, w.e2))
    high = max(w.e0, max(w.e1, w.e2))
    if low < -w.e_error and high > w.e_error:
        return MISS
    if low > w.e_error:
        return 1
    if high < -w.e_error:
        return -1
    return UNSURE


@kernel
def verdict(w, tmin, tmax):
    """Does the ray meet the closed triangle inside (tmin, tmax)? The sign of d . n, MISS, or UNSURE.

    tmin, tmax have the float type of w, and are exact.
    """
    side = line_verdict(w)
    if side == MISS or side == UNSURE:
        return side
    t = w.t if side > 0 else -w.t
    d = w.d if side > 0 else -w.d
    near = t - tmin * d
    slack = w.t_error + tmin * w.d_error
    if not near > slack:
        return MISS if near < -slack else UNSURE
    if tmax < np.inf:
        far = tmax * d - t
        slack = w.t_error + tmax * w.d_error
        if not far > slack:
            return MISS if far < -slack else UNSURE
    return side


@kernel
def meets(ray, corners, i):
    """Sign of d . n if the ray meets triangle i inside its open interval, else 0: the contract's answer."""
    side = verdict(volumes64(ray, corners, i), ray.tmin, ray.tmax)
    return exact_meets(ray, corners, i) if side == UNSURE else side


@kernel
def hit_t(ray, corners, i):
    """t where the line of the ray meets the plane of triangle i, which it is known to meet.

    One fixed float64 expression, so every method finds the same number; relative error at most 2**-30 even for grazing
    rays (those are evaluated exactly).
    """
    w = volumes64(ray, corners, i)
    if w.t_error <= _T_ACCURACY * abs(w.t) and w.d_error <= _T_ACCURACY * abs(w.d):
        return w.t / w.d
    return exact_t(ray, corners, i)


@kernel
def plane_side(x, y, z, corners, i):
    """Side of the plane of triangle i on which a float32 point lies: 1 where the normal points, -1, 0 on the plane."""
    f = np.float64
    x0, y0, z0 = f(corners[i, 0]), f(corners[i, 1]), f(corners[i, 2])
    a = (f(x) - x0, f(y) - y0, f(z) - z0)
    p = (f(corners[i, 3]) - x0, f(corners[i, 4]) - y0, f(corners[i, 5]) - z0)
    q = (f(corners[i, 6]) - x0, f(corners[i, 7]) - y0, f(corners[i, 8]) - z0)
    w = _volumes(a, a, p, q, _U64, _TINY64)
    if abs(w.t) > w.t_error:
        return 1 if w.t > 0.0 else -1
    return exact_plane_side(f(x), f(y), f(z), corners, i)
