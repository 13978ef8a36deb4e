"""Where a ray meets a triangle: t, rounded to the nearest float64, and the weights of the triangle's corners.

t = T / D is a quotient of two determinants (see `filters`). Its rounding is unique, whatever computed it, so all
methods report the same t. Intervals are compared with this number, and it orders hits.

Twice float64 decides nearly all roundings. A number is an unevaluated sum hi + lo here. Let u = 2**-53, m the largest
component of a, s that of p and q, and l that of d. a, p and q must be exact differences. Then, to second order,

    n = p x q:  |hi| <= 2 s s,  |lo| <= 4 u s s,  error 6 u u s s
    T = a . n:  error 3 (6 + 4 + 6) u u m s s + 28 u u m s s = 76 u u m s s        D = d . n:  76 u u l s s

A component of T carries n's error, and the rounding of m lo and of its sum with the product's second part. Their sums
add the rest. q = T / D is then corrected by (T - q D) / D, with an error of 12 u u q. ``_ROOM`` = 256 leaves room. If
the corrected t rounds to the same number at both ends of this error, the number is right. Else `exact_t` decides.
"""

import numpy as np

from ..jit import inlined, kernel
from ..simd import get, product_error
from .exact import exact_t, exact_weights
from .filters import T_ACCURACY, edges64, is_nearer, volumes64, volumes_of, widest

_ROOM = np.float64(256 * 2.0**-106)
_APART = np.float64(2.0**-27)  # more than the errors of two `hit_t`
_WEIGHTS = np.float64(2.0**-27)  # accuracy of weights that float32 holds
UNKNOWN = np.float64(-1.0)


@inlined
def _sum(a, b):
    """(hi, lo): hi = fl(a + b) and hi + lo == a + b."""
    hi = a + b
    other = hi - a
    return hi, (a - (hi - other)) + (b - other)


@inlined
def _product(a, b):
    """(hi, lo): hi = fl(a b) and hi + lo == a b."""
    hi = a * b
    return hi, product_error(a, b, hi)


@inlined
def _minor(a, b, c, d):
    """a b - c d, as hi + lo."""
    (p, p_low), (q, q_low) = _product(a, b), _product(c, d)
    hi, lo = _sum(p, -q)
    return hi, lo + (p_low - q_low)


@inlined
def _dot(a, x, y, z):
    """a . n, as hi + lo; x, y, z: the components of n, as hi + lo."""
    (p, i), (q, j), (r, k) = _product(a[0], x[0]), _product(a[1], y[0]), _product(a[2], z[0])
    i, j, k = i + a[0] * x[1], j + a[1] * y[1], k + a[2] * z[1]
    hi, more = _sum(p, q)
    hi, rest = _sum(hi, r)
    return _sum(hi, (more + rest) + ((i + j) + k))


@inlined
def _larger(a, b):
    return a if a > b else b


@inlined
def quick_t(d, a, p, q):
    """t rounded to the nearest float64, or UNKNOWN where twice float64 cannot tell.

    d, a, p, q : the direction, and the exact differences v0 - o, v1 - v0 and v2 - v0
    """
    # Eq. (17) of docs/design/exactness.md
    x, y, z = _minor(p[1], q[2], p[2], q[1]), _minor(p[2], q[0], p[0], q[2]), _minor(p[0], q[1], p[1], q[0])
    volume, volume_low = _dot(a, x, y, z)
    det, det_low = _dot(d, x, y, z)
    t, inverse = volume / det, 1.0 / det
    back, back_low = _product(t, det)
    rest = (((volume - back) - back_low) + (volume_low - t * det_low)) * inverse
    s = _larger(widest(p), widest(q))
    error = _ROOM * ((widest(a) + abs(t) * widest(d)) * (s * s) * abs(inverse) + abs(t))
    low, high = t + (rest - error), t + (rest + error)
    return low if low == high else UNKNOWN


@inlined
def quick_weights(d, a, p, q):
    """Weights of the second and third corner, each with an error of at most 2**-26, or UNKNOWN for the second one."""
    w = volumes_of(d, a, p, q)
    certain = _WEIGHTS * abs(w.d)
    b, c = w.e1 / w.d, w.e2 / w.d
    return (b if w.e_error <= certain and w.d_error <= certain else UNKNOWN), c


@inlined
def _is_difference(x, y, difference):
    """Is the rounded difference x - y exact?"""
    return (x - difference == y) & (difference + y == x)


@inlined
def are_differences(o, v0, v1, v2, a, p, q):
    """Are a = v0 - o, p = v1 - v0 and q = v2 - v0 exact? All are tuples of three float64."""
    exact = True
    for k in range(3):
        exact &= _is_difference(v0[k], o[k], a[k])
        exact &= _is_difference(v1[k], v0[k], p[k]) & _is_difference(v2[k], v0[k], q[k])
    return exact


@inlined
def _corner(corners, i, k):
    f, at = np.float64, 9 * i + 3 * k
    return f(get(corners, at)), f(get(corners, at + 1)), f(get(corners, at + 2))


@inlined
def _minus(a, b):
    return a[0] - b[0], a[1] - b[1], a[2] - b[2]


@kernel
def rounded_t(ray, corners, i):
    """t where the ray's line meets the plane of triangle i, rounded to the nearest float64. The line must meet it."""
    o, d = (ray.ox, ray.oy, ray.oz), (ray.dx, ray.dy, ray.dz)
    v0, v1, v2 = _corner(corners, i, 0), _corner(corners, i, 1), _corner(corners, i, 2)
    a, p, q = _minus(v0, o), _minus(v1, v0), _minus(v2, v0)
    t = UNKNOWN
    if ray.rx == 0.0 and ray.ry == 0.0 and ray.rz == 0.0 and are_differences(o, v0, v1, v2, a, p, q):
        t = quick_t(d, a, p, q)
    return t if t != UNKNOWN else exact_t(ray, corners, i)


@kernel
def hit_t(ray, corners, i):
    """t where the ray's line meets the plane of triangle i, with a relative error of at most 2**-29.

    The ray must meet the triangle. One float64 expression is fixed, so all methods that show pictures find the same
    number. Grazing rays have `rounded_t`.
    """
    w = volumes64(ray, corners, i)
    if w.t_error <= T_ACCURACY * abs(w.t) and w.d_error <= T_ACCURACY * abs(w.d):
        return w.t / w.d
    return rounded_t(ray, corners, i)


@inlined
def share(weight):
    """A weight in float32. The real one is between 0 and 1."""
    return np.float32(min(max(weight, np.float64(0.0)), np.float64(1.0)))


@kernel
def single_weights(ray, corners, i):
    """Weights of the second and third corner where the ray meets triangle i, in float32 and from 0 to 1."""
    a, p, q = edges64(corners, i, ray.ox, ray.oy, ray.oz)
    b, c = quick_weights((ray.dx, ray.dy, ray.dz), a, p, q)
    if b == UNKNOWN:
        b, c = exact_weights(ray, corners, i)
    return share(b), share(c)


@kernel
def _comes_first(ray, corners, slot, prim, best_slot, best_prim):
    """`comes_first` of two hits that lie close together. Not inlined, to keep this code out of hot loops."""
    return is_nearer(rounded_t(ray, corners, slot), prim, rounded_t(ray, corners, best_slot), best_prim)


@inlined
def comes_first(ray, corners, slot, prim, t, best_slot, best_prim, best_t):
    """Does a hit come before the best one so far? By `rounded_t`, then by index; t and best_t are of `hit_t`."""
    apart = _APART * best_t
    if t < best_t - apart:
        return True
    return not t > best_t + apart and _comes_first(ray, corners, slot, prim, best_slot, best_prim)
