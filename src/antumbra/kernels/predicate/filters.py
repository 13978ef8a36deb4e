"""Filters of the exact predicate: a float32 test, then a float64 test, each with a proven error bound.

One body serves both precisions. Let u be the unit roundoff (2**-24 or 2**-53), a = v0 - o, p = v1 - v0, q = v2 - v0:

    r = d x a    e2 = p . r    e1 = -q . r    n = p x q    D = d . n    e0 = D - e1 - e2    T = a . n

Every component of d, a, p, q is one rounded difference (relative error u). A product of three of them inside a sum of
six carries at most 3 (inputs) + 1 + 1 (products) + 1 + 2 (sums) = 8 factors (1 + u). The six products sum to at most
2 |d|_1 |a|_inf |p|_inf. Let m = |a|_inf, and s the largest component of p and q. To first order:

    |error e1|, |error e2| <= 16 u |d|_1 m s      |error D| <= 16 u |d|_1 s s      |error T| <= 16 u |a|_1 s s

e0 adds three such errors and two roundings (at most 10 u |d|_1 s max(m, s)). So 60 u |d|_1 s max(m, s) bounds the error
of each e. ``_FACTOR`` = 20 leaves room for the second order and for the rounding of the bounds themselves. An absolute
term covers underflow. Where a product could overflow, the bound is infinite, so the answer is UNSURE. No NaN ever
decides.

The comparisons with tmin and tmax allow twice D's error. The other half covers the rounding of tmin D, of tmin to
float32, and of the t that is compared to float64: at most 2 u |d|_1 s s each.
"""

from typing import NamedTuple

import numpy as np

from ..jit import inlined, kernel
from ..simd import get
from .exact import exact_has_area, exact_meets, exact_plane_side, exact_weights

MISS, UNSURE = 0, 2  # a hit is the sign of d . n: 1 or -1

_FACTOR = 20.0
BEYOND = np.float64(1.0 + 2.0**-20)  # covers the error of `hits.hit_t` (2**-29) and a rounding to float32
T_ACCURACY = np.float64(2.0**-30)  # relative accuracy of `hit_t`'s numerator and denominator, and of `weights`
END_FLOOR = np.float32(2.0**-100)  # added to an end in its error bound: more than underflow takes from tmin or tmax


class _Limits(NamedTuple):
    """Constants of one float type."""

    u: float  # _FACTOR times the unit roundoff
    three: float
    tiny: float  # larger than any error from underflow
    large: float  # a product of three lengths below this cannot overflow
    infinite: float


_LIMITS32 = _Limits(*(np.float32(x) for x in (_FACTOR * 2.0**-24, 3, 1e-37, 1e12, np.inf)))
_LIMITS64 = _Limits(*(np.float64(x) for x in (_FACTOR * 2.0**-53, 3, 1e-300, 1e100, np.inf)))


class Volumes(NamedTuple):
    """The determinants of a line and a triangle, and their error bounds. All fields have one float type."""

    e0: float
    e1: float
    e2: float
    t: float  # det(a, b, c)
    d: float  # d . n
    e_error: float  # bound for each of e0, e1, e2
    t_error: float
    d_error: float


@inlined
def _larger(a, b):
    """The larger of two numbers that are not NaN. Python's own max compiles to tests for NaN."""
    return a if a > b else b


@inlined
def _smaller(a, b):
    return a if a < b else b


@inlined
def widest(v):
    """Largest magnitude of a vector's three components."""
    return _larger(_larger(abs(v[0]), abs(v[1])), abs(v[2]))


@inlined
def cross(a, b):
    """a x b of tuples of three numbers."""
    return a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]


@inlined
def dot(a, b):
    """a . b of tuples of three numbers."""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@inlined
def _volumes(d, a, p, q, limits):
    r, n = cross(d, a), cross(p, q)
    e2, e1 = dot(p, r), -dot(q, r)
    det, volume = dot(d, n), dot(a, n)
    d1 = abs(d[0]) + abs(d[1]) + abs(d[2])
    m, s = widest(a), _larger(widest(p), widest(q))
    wide, uss = _larger(m, s), limits.u * s * s
    floor = limits.tiny * (d1 + wide) + limits.tiny
    three = limits.three
    e_error = three * limits.u * (d1 * s * wide) + floor  # in this order, because u * d1 could underflow
    e_error = e_error if _larger(d1, wide) < limits.large else limits.infinite
    return Volumes(det - e1 - e2, e1, e2, volume, det, e_error, three * m * uss + floor, d1 * uss + floor)


@inlined
def volumes32(o, d, corners, i):
    """`Volumes` in float32. o and d are tuples of three float32, and d is the ray's direction rounded once."""
    k = 9 * i
    x, y, z = get(corners, k), get(corners, k + 1), get(corners, k + 2)
    a = (x - o[0], y - o[1], z - o[2])
    p = (get(corners, k + 3) - x, get(corners, k + 4) - y, get(corners, k + 5) - z)
    q = (get(corners, k + 6) - x, get(corners, k + 7) - y, get(corners, k + 8) - z)
    return _volumes(d, a, p, q, _LIMITS32)


@inlined
def edges64(corners, i, x, y, z):
    """(v0 - (x, y, z), v1 - v0, v2 - v0) in float64."""
    f, k = np.float64, 9 * i
    x0, y0, z0 = f(get(corners, k)), f(get(corners, k + 1)), f(get(corners, k + 2))
    p = (f(get(corners, k + 3)) - x0, f(get(corners, k + 4)) - y0, f(get(corners, k + 5)) - z0)
    q = (f(get(corners, k + 6)) - x0, f(get(corners, k + 7)) - y0, f(get(corners, k + 8)) - z0)
    return (x0 - x, y0 - y, z0 - z), p, q


@inlined
def volumes_of(d, a, p, q):
    """`Volumes` in float64; d, a, p, q as above, tuples of three float64."""
    return _volumes(d, a, p, q, _LIMITS64)


@inlined
def volumes64(ray, corners, i):
    """`Volumes` in float64, of the leading part of the ray's direction."""
    return volumes_of((ray.dx, ray.dy, ray.dz), *edges64(corners, i, ray.ox, ray.oy, ray.oz))


@inlined
def line_verdict(w):
    """Whether the line meets the closed triangle: the sign of d . n, MISS, or UNSURE."""
    low = _smaller(w.e0, _smaller(w.e1, w.e2))
    high = _larger(w.e0, _larger(w.e1, w.e2))
    if low < -w.e_error and high > w.e_error:
        return MISS
    if low > w.e_error:
        return 1
    if high < -w.e_error:
        return -1
    return UNSURE


@inlined
def verdict(w, tmin, tmax):
    """Whether the ray meets the closed triangle inside (tmin, tmax): the sign of d . n, MISS, or UNSURE.

    tmin and tmax have the float type of w, rounded to nearest. NaN decides nothing.
    """
    side = line_verdict(w)
    if side == MISS or side == UNSURE:
        return side
    t = w.t if side > 0 else -w.t
    d = w.d if side > 0 else -w.d
    ends_error = w.d_error + w.d_error
    near = t - tmin * d
    slack = w.t_error + (tmin + END_FLOOR) * ends_error
    if not near > slack:
        return MISS if near < -slack else UNSURE
    if tmax != np.inf:
        far = tmax * d - t
        slack = w.t_error + (tmax + END_FLOOR) * ends_error
        if not far > slack:
            return MISS if far < -slack else UNSURE
    return side


@inlined
def single_end(t):
    """tmin or tmax in float32 for `verdict`; NaN where float32 has no such number."""
    rounded = np.float32(t)
    return rounded if rounded < np.inf or t == np.inf else np.float32(np.nan)


@kernel
def meets(ray, corners, i):
    """Sign of d . n if the ray meets triangle i inside its open interval, else 0. The answer is exact."""
    side = verdict(volumes64(ray, corners, i), ray.tmin, ray.tmax)
    return exact_meets(ray, corners, i) if side == UNSURE else side


@kernel
def weights(ray, corners, i):
    """Weights of the second and third corner where the ray meets triangle i, each with an error of at most 2**-29."""
    w = volumes64(ray, corners, i)
    certain = T_ACCURACY * abs(w.d)
    if w.e_error <= certain and w.d_error <= certain:
        return w.e1 / w.d, w.e2 / w.d
    return exact_weights(ray, corners, i)


@inlined
def is_nearer(t, prim, other_t, other_prim):
    """Is a ray's hit nearer than another one? Of two hits at the same t, the lower index of a triangle is."""
    return t < other_t or (t == other_t and prim < other_prim)


@inlined
def plane(corners, i, x, y, z):
    """Plane of triangle i in float64: (v0 - (x, y, z), normal n, error bound e).

    For any vector a from v0 to a point, the error of a . n is at most e |a|_inf.
    """
    a, p, q = edges64(corners, i, x, y, z)
    s = _larger(widest(p), widest(q))
    return a, cross(p, q), _LIMITS64.three * _LIMITS64.u * s * s + _LIMITS64.tiny


@inlined
def has_area(corners, i):
    """Whether triangle i has an area. The answer is exact."""
    zero = np.float64(0.0)
    _, n, error = plane(corners, i, zero, zero, zero)
    return widest(n) > error or exact_has_area(corners, i)


@inlined
def side_of(v0, n, error, x, y, z, corners, i):
    """`plane_side` from the `plane` (v0, n, error) of triangle i relative to (0, 0, 0)."""
    f = np.float64
    a = (v0[0] - f(x), v0[1] - f(y), v0[2] - f(z))
    volume = -dot(a, n)
    if abs(volume) > error * widest(a):
        return 1 if volume > 0.0 else -1
    return exact_plane_side(f(x), f(y), f(z), corners, i)


@kernel
def plane_side(x, y, z, corners, i):
    """The side of triangle i's plane on which a float32 point lies: 1 where the normal points, -1 behind, 0 on it."""
    zero = np.float64(0.0)
    v0, n, error = plane(corners, i, zero, zero, zero)
    return side_of(v0, n, error, x, y, z, corners, i)
