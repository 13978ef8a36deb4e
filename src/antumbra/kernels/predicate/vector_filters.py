"""The float32 filter of `filters` in lanes: one ray and eight triangles, or sixteen rays and one triangle.

The quantities are as in `filters`: a = v0 - o, p, q, r = d x a, n = p x q, e1, e2, D, T, e0 = D - e1 - e2. Every
component of a, d, p, q is one rounded difference. Each of e1, e2, D, T is a sum of six products of three components.
So a product collects at most 8 factors (1 + u): 3 from its components, 2 in the cross product, 1 in the dot product and
2 in its sums. Where the processor fuses products and sums, there are fewer factors. Two bounds follow.

*Coarse bound*, for all lanes. Let m = |a|_inf, and s the largest component of p and q. The six products sum to at most
2 |d|_1 m s. So |error e1|, |error e2| <= 16 u |d|_1 m s. As in `filters`, |error e0| <= (3 * 16 + 10) u |d|_1 s max(m,
s). e1, e2 and e0 / 3 are compared with 20 u |d|_1 s max(m, s). Since 58 < 3 * 20, room is left for the second order and
for the rounding of e0 / 3 and of the bound. If one e is surely negative and another surely positive, the line misses.

*Fine bound*, where a lane remains. The error of a sum is at most 8 u P. P is the sum of the same six products as
magnitudes (the permanent), computed within 6 u. The fine bound is much smaller where components are zero: for triangles
in axis-aligned planes, and rays along axes. e0 carries 8 u (P_D + P_e1 + P_e2) and two more roundings of at most u
times the same sum. So 12 u P bounds each quantity, with the same room as above. tmin and tmax are rounded to float32,
and their products with D are rounded. As in `filters`, these comparisons allow twice D's error, and a floor covers
underflow of tmin and tmax.

An absolute term covers underflow. Where a product could overflow, `unit` is infinite and the test decides nothing. A
decision needs a comparison with a bound that comes out *true*, and comparisons with infinity and NaN never do.
"""

from typing import NamedTuple

import numpy as np

from ..fields import F32Lanes
from ..jit import inlined
from ..simd import absolute, any_lane, bits, flip_sign, fma, maximum, minimum, select
from .filters import END_FLOOR

_COARSE = np.float32(20.0 * 2.0**-24)
_FINE = np.float32(12.0 / 20.0)  # of the coarse unit
_THIRD = np.float32(1.0 / 3.0)
_TINY = np.float32(1e-37)  # larger than any error from underflow, for each unit of length


class FilterRays(NamedTuple):
    """Rays for `meet`, one a lane. All fields are float32 vectors."""

    ox: F32Lanes
    oy: F32Lanes
    oz: F32Lanes
    dx: F32Lanes
    dy: F32Lanes
    dz: F32Lanes
    tmin: F32Lanes  # rounded to nearest
    tmax: F32Lanes  # the same; inf if there is no end, or if it lies beyond float32 and `unit` is inf
    unit: F32Lanes  # 20 u, or inf where a product could overflow
    floor: F32Lanes  # largest error from underflow


class FilterTriangles(NamedTuple):
    """Triangles, one a lane. All fields are float32 vectors. The edges are rounded differences of the corners."""

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

    tame : mask of the lanes in which |d|_inf and reach are at most 2^40, so no product of three overflows
    reach : upper bound of the magnitudes of all coordinates
    """
    span = absolute(dx) + absolute(dy) + absolute(dz) + (reach + reach)
    return select(tame, span * np.float32(0.0) + _COARSE, np.float32(np.inf)), fma(span, _TINY, _TINY)


@inlined
def _sum3(ax, bx, ay, by, az, bz):
    return fma(ax, bx, fma(ay, by, az * bz))


@inlined
def meet(r, t):
    """(hits, positive, unsure) of each lane's ray and triangle, as bit masks: bit k is lane k.

    hits : the ray surely meets the triangle inside (tmin, tmax)
    positive : d . n > 0; valid for hits
    unsure : the ray may meet the triangle
    """
    ax, ay, az = t.x - r.ox, t.y - r.oy, t.z - r.oz
    rx, ry, rz = fma(r.dy, az, -(r.dz * ay)), fma(r.dz, ax, -(r.dx * az)), fma(r.dx, ay, -(r.dy * ax))
    nx, ny, nz = fma(t.py, t.qz, -(t.pz * t.qy)), fma(t.pz, t.qx, -(t.px * t.qz)), fma(t.px, t.qy, -(t.py * t.qx))
    e2, e1 = _sum3(t.px, rx, t.py, ry, t.pz, rz), -_sum3(t.qx, rx, t.qy, ry, t.qz, rz)
    det = _sum3(r.dx, nx, r.dy, ny, r.dz, nz)
    e0 = det - e1 - e2
    lx, ly, lz, hx, hy, hz = absolute(ax), absolute(ay), absolute(az), absolute(r.dx), absolute(r.dy), absolute(r.dz)
    wide = maximum(maximum(maximum(lx, ly), lz), t.s)
    bound = fma(wide * t.s, (hx + hy + hz) * r.unit, r.floor)
    third = e0 * _THIRD
    low, high = minimum(third, minimum(e1, e2)), maximum(third, maximum(e1, e2))
    maybe = ~((low < -bound) & (high > bound))
    if not any_lane(maybe):
        return np.int64(0), np.int64(0), np.int64(0)
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
    near, near_bound = volume - r.tmin * det, fma(r.tmin + END_FLOOR, b_ends, b_volume)
    endless = ~(r.tmax < np.float32(np.inf))
    tmax = select(endless, np.float32(0.0), r.tmax)
    far, far_bound = tmax * det - volume, fma(tmax + END_FLOOR, b_ends, b_volume)
    inside = (near > near_bound) & (endless | (far > far_bound))
    outside = (near < -near_bound) | (~endless & (far < -far_bound))
    hits = line & inside
    return bits(hits), bits(positive), bits(maybe & ~hits & ~miss & ~(line & outside))
