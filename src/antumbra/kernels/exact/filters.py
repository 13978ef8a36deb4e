"""Filters of the exact predicate, scalar and in lanes, and the coordinates of a hit, all with proven error bounds.

Scalar filters. A float32 test is followed by a float64 test, with one body for both precisions. Let u be the unit
roundoff (2**-24 or 2**-53), a = v0 - o, p = v1 - v0, q = v2 - v0:

    r = d x a    e2 = p . r    e1 = -q . r    n = p x q    D = d . n    e0 = D - e1 - e2    T = a . n

Every component of d, a, p, q is one rounded difference (relative error u). A product of three of them inside a sum of
six carries at most 3 (inputs) + 1 + 1 (products) + 1 + 2 (sums) = 8 factors (1 + u). The six products sum to at most
2 |d|_1 |a|_inf |p|_inf. Let m = |a|_inf, and let s be the largest component of p and q. To first order:

    |error e1|, |error e2| <= 16 u |d|_1 m s      |error D| <= 16 u |d|_1 s s      |error T| <= 16 u |a|_1 s s

e0 adds three such errors and two roundings (at most 10 u |d|_1 s max(m, s)). So 60 u |d|_1 s max(m, s) bounds the error
of each e. ``_FACTOR`` = 20 leaves a margin for second-order terms and for the rounding of the bounds themselves. An
absolute term covers underflow. If a product could overflow, the bound is infinite and the answer is UNSURE. NaN never
decides anything.

The comparisons with tmin and tmax allow twice the error of D. The second half covers the roundings of tmin D, of tmin
to float32, and of the compared t to float64: at most 2 u |d|_1 s s each.

Filters in lanes. The float32 filter tests one ray against eight triangles, or sixteen rays against one triangle. The
quantities are as above: a = v0 - o, p, q, r = d x a, n = p x q, e1, e2, D, T, e0 = D - e1 - e2. Every component of a,
d, p, q is one rounded difference. Each of e1, e2, D, T is a sum of six products of three components, so a product
accumulates at most 8 factors (1 + u): 3 from its components, 2 in the cross product, 1 in the dot product and 2 in its
sums. Processors that fuse products and sums give fewer factors. Two bounds follow.

*Coarse bound*, for all lanes. Let m = |a|_inf, and let s be the largest component of p and q. The six products sum to
at most 2 |d|_1 m s. So |error e1|, |error e2| <= 16 u |d|_1 m s and, as above, |error e0| <= (3 * 16 + 10) u |d|_1 s
max(m, s). e1, e2 and e0 / 3 are compared with 20 u |d|_1 s max(m, s). Since 58 < 3 * 20, this leaves a margin for
second-order terms and for the rounding of e0 / 3 and of the bound. If one e is certainly negative and another certainly
positive, the line misses.

*Fine bound*, if any lane remains. The error of a sum is at most 8 u P, where P is the sum of the magnitudes of the same
six products (the permanent), computed within 6 u. The fine bound is much smaller if components are zero: for triangles
in axis-aligned planes and axis-parallel rays. e0 carries 8 u (P_D + P_e1 + P_e2) and two more roundings of at most u
times the same sum. So 12 u P bounds each quantity, with the same margin as above. tmin and tmax are rounded to float32,
and so are their products with D. As above, these comparisons allow twice the error of D, and a floor covers underflow
of tmin and tmax.

An absolute term covers underflow. If a product could overflow, `unit` is infinite and the test decides nothing: a
decision requires a comparison with a bound to be *true*, and comparisons with infinity and NaN never are.

Hit coordinates. A hit consists of t, rounded to the nearest float64, and the weights of the triangle's corners.
t = T / D is a quotient of two determinants (see above). Correct rounding is unique however it is computed, so all
methods report the same t. This number is compared with intervals and orders hits.

Double-double arithmetic decides nearly all roundings: a number is an unevaluated sum hi + lo. Let u = 2**-53, and let m
be the largest component of a, s that of p and q, and l that of d. a, p and q must be exact differences. Then, to second
order,

    n = p x q:  |hi| <= 2 s s,  |lo| <= 4 u s s,  error 6 u u s s
    T = a . n:  error 3 (6 + 4 + 6) u u m s s + 28 u u m s s = 76 u u m s s        D = d . n:  76 u u l s s

A component of T carries the error of n, and the roundings of m lo and of its sum with the low part of the product. The
sums of components add the remainder. q = T * (1 / D), with an error of 3 u q, is then corrected by (T - q D) * (1 / D),
with an error of 32 u u q. ``_ROOM`` = 256 leaves a margin. If the corrected t rounds to the same number at both ends of
the error interval, that number is correct; otherwise `exact_t` decides.
"""

from typing import NamedTuple

import numpy as np

from ..jit import F32Lanes, inlined, kernel
from ..simd import absolute, any_lane, bits, flip_sign, fma, get, maximum, minimum, product_error, select
from .predicate import exact_has_area, exact_meets, exact_plane_side, exact_t, exact_weights

# --- Scalar filters ---------------------------------------------------------------------------------------------------


MISS, UNSURE = 0, 2  # a hit is the sign of d . n: 1 or -1

_FACTOR = 20.0
BEYOND = np.float64(1.0 + 2.0**-20)  # covers the error of `hit_t` (2**-29) and rounding to float32
T_ACCURACY = np.float64(2.0**-30)  # relative accuracy of `hit_t`'s numerator and denominator, and of `weights`
END_FLOOR = np.float32(2.0**-100)  # added to tmin or tmax in their error bounds; more than underflow can take from them


class _Limits(NamedTuple):
    """Constants for one float type."""

    u: float  # _FACTOR times the unit roundoff
    three: float
    tiny: float  # larger than any error from underflow
    large: float  # a product of three lengths below this cannot overflow
    infinite: float


_LIMITS32 = _Limits(*(np.float32(x) for x in (_FACTOR * 2.0**-24, 3, 1e-37, 1e12, np.inf)))  # type: ignore[arg-type]
_LIMITS64 = _Limits(*(np.float64(x) for x in (_FACTOR * 2.0**-53, 3, 1e-300, 1e100, np.inf)))


class Volumes(NamedTuple):
    """The determinants of a line and a triangle, and their error bounds. All fields have the same float type."""

    e0: float
    e1: float
    e2: float
    t: float  # det(a, b, c)
    d: float  # d . n
    e_error: float  # bound for each of e0, e1, e2
    t_error: float
    d_error: float


@inlined
def larger(a, b):
    """The larger of two numbers that are not NaN. Python's max would compile to tests for NaN."""
    return a if a > b else b


@inlined
def smaller(a, b):
    """The smaller of two numbers that are not NaN."""
    return a if a < b else b


@inlined
def max_magnitude(v):
    """Largest magnitude of a vector's three components."""
    return larger(larger(abs(v[0]), abs(v[1])), abs(v[2]))


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
    m, s = max_magnitude(a), larger(max_magnitude(p), max_magnitude(q))
    wide, uss = larger(m, s), limits.u * s * s
    floor = limits.tiny * (d1 + wide) + limits.tiny
    three = limits.three
    e_error = three * limits.u * (d1 * s * wide) + floor  # in this order, since u * d1 could underflow
    e_error = e_error if larger(d1, wide) < limits.large else limits.infinite
    return Volumes(det - e1 - e2, e1, e2, volume, det, e_error, three * m * uss + floor, d1 * uss + floor)


@inlined
def volumes32(o, d, corners, i):
    """`Volumes` in float32. o and d are tuples of three float32; d is the ray's direction, rounded once."""
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
    low = smaller(w.e0, smaller(w.e1, w.e2))
    high = larger(w.e0, larger(w.e1, w.e2))
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
    t_near = t - tmin * d
    slack = w.t_error + (tmin + END_FLOOR) * ends_error
    if not t_near > slack:
        return MISS if t_near < -slack else UNSURE
    if tmax != np.inf:
        t_far = tmax * d - t
        slack = w.t_error + (tmax + END_FLOOR) * ends_error
        if not t_far > slack:
            return MISS if t_far < -slack else UNSURE
    return side


@inlined
def float32_end(t):
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
def plane(corners, i, x, y, z):
    """Plane of triangle i in float64: (v0 - (x, y, z), normal n, error bound e).

    For any vector a from v0 to a point, the error of a . n is at most e |a|_inf.
    """
    a, p, q = edges64(corners, i, x, y, z)
    s = larger(max_magnitude(p), max_magnitude(q))
    return a, cross(p, q), _LIMITS64.three * _LIMITS64.u * s * s + _LIMITS64.tiny


@inlined
def has_area(corners, i):
    """Whether triangle i has an area. The answer is exact."""
    zero = np.float64(0.0)
    _, n, error = plane(corners, i, zero, zero, zero)
    return max_magnitude(n) > error or exact_has_area(corners, i)


@inlined
def quick_side(v0, n, error, x, y, z):
    """`side_of` without exact arithmetic: 1, -1 or UNSURE."""
    f = np.float64
    a = (v0[0] - f(x), v0[1] - f(y), v0[2] - f(z))
    volume = -dot(a, n)
    if abs(volume) > error * max_magnitude(a):
        return 1 if volume > 0.0 else -1
    return UNSURE


@inlined
def side_of(v0, n, error, x, y, z, corners, i):
    """`plane_side` from the `plane` (v0, n, error) of triangle i relative to (0, 0, 0)."""
    side = quick_side(v0, n, error, x, y, z)
    return exact_plane_side(np.float64(x), np.float64(y), np.float64(z), corners, i) if side == UNSURE else side


@kernel
def plane_side(x, y, z, corners, i):
    """The side of triangle i's plane that a float32 point is on: 1 if the normal points there, -1 behind, 0 on it."""
    zero = np.float64(0.0)
    v0, n, error = plane(corners, i, zero, zero, zero)
    return side_of(v0, n, error, x, y, z, corners, i)


@inlined
def is_front(ray, corners, i):
    """Whether the ray's origin is in front of triangle i, which the ray meets: d . n < 0. The answer is exact."""
    return plane_side(ray.ox, ray.oy, ray.oz, corners, i) > 0


# --- The float32 filter in lanes --------------------------------------------------------------------------------------


_COARSE = np.float32(20.0 * 2.0**-24)
_FINE = np.float32(12.0 / 20.0)  # of the coarse unit
_THIRD = np.float32(1.0 / 3.0)
_TINY = np.float32(1e-37)  # larger than any error from underflow, for each unit of length
_LESS, _MORE = np.float32(1.0 - 2.0**-21), np.float32(1.0 + 2.0**-21)  # more than the roundings of a quotient


class FilterRays(NamedTuple):
    """Rays for `filter_hits`, one per lane. All fields are float32 vectors."""

    ox: F32Lanes
    oy: F32Lanes
    oz: F32Lanes
    dx: F32Lanes
    dy: F32Lanes
    dz: F32Lanes
    tmin: F32Lanes  # rounded to nearest
    tmax: F32Lanes  # likewise; inf if unbounded, or beyond float32 and `unit` is inf
    unit: F32Lanes  # 20 u, or inf where a product could overflow
    floor: F32Lanes  # maximum error from underflow


class FilterTriangles(NamedTuple):
    """Triangles, one per lane. All fields are float32 vectors. The edges are rounded differences of corners."""

    x: F32Lanes  # v0
    y: F32Lanes
    z: F32Lanes
    px: F32Lanes  # v1 - v0
    py: F32Lanes
    pz: F32Lanes
    qx: F32Lanes  # v2 - v0
    qy: F32Lanes
    qz: F32Lanes
    s: F32Lanes  # largest magnitude of the edges' components


@inlined
def error_unit(tame, dx, dy, dz, reach):
    """(unit, floor) of `FilterRays`, as vectors.

    tame : mask of the lanes where no product of three overflows, see `wide_traversal.triangles_fit`
    reach : upper bound of the magnitudes of all coordinates
    """
    span = absolute(dx) + absolute(dy) + absolute(dz) + (reach + reach)
    return select(tame, span * np.float32(0.0) + _COARSE, np.float32(np.inf)), fma(span, _TINY, _TINY)


@inlined
def single_error_unit(tame, span, reach):
    """`error_unit` of one ray; scalars. span : the sum of the magnitudes of its direction's components."""
    unit = _COARSE if tame else np.float32(np.inf)
    return unit, (span + (reach + reach)) * _TINY + _TINY


@inlined
def _sum3(ax, bx, ay, by, az, bz):
    return fma(ax, bx, fma(ay, by, az * bz))


@inlined
def _lines(r, t):
    """(a, n, (e0, e1, e2), det) of each lane's line and triangle."""
    ax, ay, az = t.x - r.ox, t.y - r.oy, t.z - r.oz
    rx, ry, rz = fma(r.dy, az, -(r.dz * ay)), fma(r.dz, ax, -(r.dx * az)), fma(r.dx, ay, -(r.dy * ax))
    nx, ny, nz = fma(t.py, t.qz, -(t.pz * t.qy)), fma(t.pz, t.qx, -(t.px * t.qz)), fma(t.px, t.qy, -(t.py * t.qx))
    e2, e1 = _sum3(t.px, rx, t.py, ry, t.pz, rz), -_sum3(t.qx, rx, t.qy, ry, t.qz, rz)
    det = _sum3(r.dx, nx, r.dy, ny, r.dz, nz)
    return (ax, ay, az), (nx, ny, nz), (det - e1 - e2, e1, e2), det


@inlined
def _lines_may_meet(r, t):
    """Mask of the lanes whose line may meet the triangle, by the coarse bound."""
    a, _, (e0, e1, e2), _ = _lines(r, t)
    wide = maximum(maximum(maximum(absolute(a[0]), absolute(a[1])), absolute(a[2])), t.s)
    span = absolute(r.dx) + absolute(r.dy) + absolute(r.dz)
    bound = fma(wide * t.s, span * r.unit, r.floor)
    third = e0 * _THIRD
    low, high = minimum(third, minimum(e1, e2)), maximum(third, maximum(e1, e2))
    return ~((low < -bound) & (high > bound))


@inlined
def lines_may_pass(r, t, slack):
    """Mask of the lanes whose line may pass within a distance of the triangle, measured along each axis.

    slack : 2 |d|_1 times this distance, a vector

    A shift of the line by at most w along each axis changes e1 and e2 by at most 2 |d|_1 s w. It changes e0, whose edge
    is up to twice as long, by at most 4 |d|_1 s w, and e0 / 3 by less than e1. The coarse bound grows by as much.
    """
    a, _, (e0, e1, e2), _ = _lines(r, t)
    wide = maximum(maximum(maximum(absolute(a[0]), absolute(a[1])), absolute(a[2])), t.s)
    span = absolute(r.dx) + absolute(r.dy) + absolute(r.dz)
    bound = fma(t.s, fma(wide, span * r.unit, slack), r.floor)
    third = e0 * _THIRD
    low, high = minimum(third, minimum(e1, e2)), maximum(third, maximum(e1, e2))
    return ~((low < -bound) & (high > bound))


class FilterHits(NamedTuple):
    """The tests of each lane's ray and triangle. Masks are int64, and bit k is lane k."""

    hits: int  # the ray certainly meets the triangle inside (tmin, tmax)
    positive: int  # d . n > 0; valid for hits
    unsure: int  # the ray may meet the triangle
    near: F32Lanes  # at most t; valid for hits
    far: F32Lanes  # at least t, perhaps inf; valid for hits


@inlined
def filter_hits(r, t):
    """`FilterHits` of each lane's ray and triangle, with an early exit if no line may meet its triangle."""
    if not any_lane(_lines_may_meet(r, t)):
        return FilterHits(np.int64(0), np.int64(0), np.int64(0), r.floor, r.floor)
    return filter_hits_branchless(r, t)


@inlined
def filter_hits_branchless(r, t):
    """`filter_hits` without the early exit."""
    possible = _lines_may_meet(r, t)
    (ax, ay, az), (nx, ny, nz), (e0, e1, e2), det = _lines(r, t)
    lx, ly, lz, hx, hy, hz = absolute(ax), absolute(ay), absolute(az), absolute(r.dx), absolute(r.dy), absolute(r.dz)
    px, py, pz, qx, qy, qz = (
        absolute(t.px),
        absolute(t.py),
        absolute(t.pz),
        absolute(t.qx),
        absolute(t.qy),
        absolute(t.qz),
    )
    rx, ry, rz = fma(hy, lz, hz * ly), fma(hz, lx, hx * lz), fma(hx, ly, hy * lx)
    mx, my, mz = fma(py, qz, pz * qy), fma(pz, qx, px * qz), fma(px, qy, py * qx)
    unit = r.unit * _FINE
    b2, b1 = _sum3(px, rx, py, ry, pz, rz), _sum3(qx, rx, qy, ry, qz, rz)
    b_det, b_volume = _sum3(hx, mx, hy, my, hz, mz), _sum3(lx, mx, ly, my, lz, mz)
    b0 = fma(b_det + b1 + b2, unit, r.floor)
    b1, b2 = fma(b1, unit, r.floor), fma(b2, unit, r.floor)
    positive = (e0 > b0) & (e1 > b1) & (e2 > b2)
    negative = (e0 < -b0) & (e1 < -b1) & (e2 < -b2)
    miss = ((e0 < -b0) | (e1 < -b1) | (e2 < -b2)) & ((e0 > b0) | (e1 > b1) | (e2 > b2))
    line = positive | negative
    volume, det = flip_sign(_sum3(ax, nx, ay, ny, az, nz), e1), absolute(det)
    b_volume, b_det = fma(b_volume, unit, r.floor), fma(b_det, unit, r.floor)
    b_ends = b_det + b_det
    t_near, t_near_bound = volume - r.tmin * det, fma(r.tmin + END_FLOOR, b_ends, b_volume)
    endless = ~(r.tmax < np.float32(np.inf))
    tmax = select(endless, np.float32(0.0), r.tmax)
    t_far, t_far_bound = tmax * det - volume, fma(tmax + END_FLOOR, b_ends, b_volume)
    inside = (t_near > t_near_bound) & (endless | (t_far > t_far_bound))
    outside = (t_near < -t_near_bound) | (~endless & (t_far < -t_far_bound))
    hits = line & inside
    unsure = possible & ~hits & ~miss & ~(line & outside)
    # Eq. (18) of docs/design/exactness.md
    near = (volume - b_volume) / (det + b_det) * _LESS - _TINY
    room = det - b_det
    far = select(room > np.float32(0.0), (volume + b_volume) / room * _MORE + _TINY, np.float32(np.inf))
    return FilterHits(bits(hits), bits(positive), bits(unsure), near, far)


# --- Hit coordinates: t and the corners' weights ----------------------------------------------------------------------


_ROOM = np.float64(256 * 2.0**-106)
_APART = np.float64(2.0**-27)  # more than the errors of two `hit_t` together
_WEIGHTS = np.float64(2.0**-27)  # accuracy of weights for float32
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
    """a b - c d as hi + lo."""
    (p, p_low), (q, q_low) = _product(a, b), _product(c, d)
    hi, lo = _sum(p, -q)
    return hi, lo + (p_low - q_low)


@inlined
def _dot(a, x, y, z):
    """a . n as hi + lo; x, y, z are the components of n as hi + lo."""
    (p, i), (q, j), (r, k) = _product(a[0], x[0]), _product(a[1], y[0]), _product(a[2], z[0])
    i, j, k = i + a[0] * x[1], j + a[1] * y[1], k + a[2] * z[1]
    hi, more = _sum(p, q)
    hi, low = _sum(hi, r)
    return _sum(hi, (more + low) + ((i + j) + k))


@inlined
def _larger_magnitude(a, b):
    return a if a > b else b


@inlined
def quick_t(d, a, p, q):
    """(t rounded to the nearest float64, d . n) of a hit.

    Where double-double arithmetic is not accurate enough, t is UNKNOWN. Otherwise, the sign of d . n is right too.

    d, a, p, q : the direction, and the exact differences v0 - o, v1 - v0 and v2 - v0
    """
    # Eq. (17) of docs/design/exactness.md
    x, y, z = _minor(p[1], q[2], p[2], q[1]), _minor(p[2], q[0], p[0], q[2]), _minor(p[0], q[1], p[1], q[0])
    volume, volume_low = _dot(a, x, y, z)
    det, det_low = _dot(d, x, y, z)
    inverse = 1.0 / det  # one division is slower than all products
    t = volume * inverse
    product, product_low = _product(t, det)
    correction = (((volume - product) - product_low) + (volume_low - t * det_low)) * inverse
    s = _larger_magnitude(max_magnitude(p), max_magnitude(q))
    error = _ROOM * ((max_magnitude(a) + abs(t) * max_magnitude(d)) * (s * s) * abs(inverse) + abs(t))
    low, high = t + (correction - error), t + (correction + error)
    return low if low == high else UNKNOWN, det


@inlined
def quick_weights(d, a, p, q):
    """Weights of the second and third corner, each with an error of at most 2**-26, or UNKNOWN for the second one."""
    w = volumes_of(d, a, p, q)
    certain, inverse = _WEIGHTS * abs(w.d), 1.0 / w.d
    return (w.e1 * inverse if w.e_error <= certain and w.d_error <= certain else UNKNOWN), w.e2 * inverse


@inlined
def _is_difference(x, y, difference):
    """Whether the rounded difference x - y is exact."""
    return (x - difference == y) & (difference + y == x)


@inlined
def are_differences(o, v0, v1, v2, a, p, q):
    """Whether a = v0 - o, p = v1 - v0 and q = v2 - v0 are exact. All are tuples of three float64."""
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
    """t where the ray's line meets the plane of triangle i, rounded to the nearest float64. It must meet the plane."""
    o, d = (ray.ox, ray.oy, ray.oz), (ray.dx, ray.dy, ray.dz)
    v0, v1, v2 = _corner(corners, i, 0), _corner(corners, i, 1), _corner(corners, i, 2)
    a, p, q = _minus(v0, o), _minus(v1, v0), _minus(v2, v0)
    t = UNKNOWN
    if ray.rx == 0.0 and ray.ry == 0.0 and ray.rz == 0.0 and are_differences(o, v0, v1, v2, a, p, q):
        t, _ = quick_t(d, a, p, q)
    return t if t != UNKNOWN else exact_t(ray, corners, i)


@kernel
def hit_t(ray, corners, i):
    """t where the ray's line meets the plane of triangle i, with a relative error of at most 2**-29.

    The ray must meet the triangle. The float64 expression is fixed, so all methods that render images compute the same
    number. Grazing rays use `rounded_t`.
    """
    w = volumes64(ray, corners, i)
    if w.t_error <= T_ACCURACY * abs(w.t) and w.d_error <= T_ACCURACY * abs(w.d):
        return w.t / w.d
    return rounded_t(ray, corners, i)


@inlined
def clamp_weight(weight):
    """A weight in float32, clamped to [0, 1], where the real weight lies."""
    return np.float32(min(max(weight, np.float64(0.0)), np.float64(1.0)))


@kernel
def single_weights(ray, corners, i):
    """Weights of the second and third corner where the ray meets triangle i, in float32 and in [0, 1]."""
    a, p, q = edges64(corners, i, ray.ox, ray.oy, ray.oz)
    b, c = quick_weights((ray.dx, ray.dy, ray.dz), a, p, q)
    if b == UNKNOWN:
        b, c = exact_weights(ray, corners, i)
    return clamp_weight(b), clamp_weight(c)


# --- The order of hits ------------------------------------------------------------------------------------------------


@inlined
def signed_t(ray, corners, i):
    """`rounded_t`, negative if the ray meets the back of triangle i. A hit's t is never 0."""
    t = rounded_t(ray, corners, i)
    return t if is_front(ray, corners, i) else -t


@inlined
def precedes(t, prim, other_t, other_prim):
    """Whether a hit precedes another one: by t; at the same t, fronts before backs; then by index.

    t, other_t : from `signed_t`; inf: no hit
    """
    if abs(t) != abs(other_t):
        return abs(t) < abs(other_t)
    return prim < other_prim if t == other_t else t > other_t


@inlined
def _is_same_point(a, i, b, j):
    return get(a, i) == get(b, j) and get(a, i + 1) == get(b, j + 1) and get(a, i + 2) == get(b, j + 2)


@inlined
def _common_sense(a, i, b, j):
    """1 or -1 if triangles i and j have the same corners, in the same or the opposite sense of rotation; else 0."""
    first = 9 * i
    for k in range(3):
        if _is_same_point(a, first, b, 9 * j + 3 * k):
            after, before = 9 * j + 3 * ((k + 1) % 3), 9 * j + 3 * ((k + 2) % 3)
            if _is_same_point(a, first + 3, b, after) and _is_same_point(a, first + 6, b, before):
                return 1
            if _is_same_point(a, first + 3, b, before) and _is_same_point(a, first + 6, b, after):
                return -1
    return 0


@kernel
def _comes_first(ray, corners, slot, prim, best_corners, best_slot, best_prim):
    """`comes_first` for two hits close together. Not inlined, to keep this code out of hot loops."""
    sense = _common_sense(corners, slot, best_corners, best_slot)  # most walls that exist twice have the same triangles
    if sense != 0:
        return prim < best_prim if sense > 0 else is_front(ray, corners, slot)
    return precedes(signed_t(ray, corners, slot), prim, signed_t(ray, best_corners, best_slot), best_prim)


@inlined
def comes_first(ray, corners, slot, prim, t, best_corners, best_slot, best_prim, best_t):
    """Whether a hit precedes the best one so far, as from `precedes`.

    t, best_t : from `hit_t` or `rounded_t`
    """
    apart = _APART * best_t
    if t < best_t - apart:
        return True
    return not t > best_t + apart and _comes_first(ray, corners, slot, prim, best_corners, best_slot, best_prim)
