"""Irradiance from uniform parallelograms and disks in closed form, clipped at the receiver's horizon.

An emitter has the same radiance everywhere, in all directions and on both sides, and unit intensity: radiance times
area is 1. Vectors are tuples of three float64, relative to the receiver; n is its unit normal. Formulas are those of
docs/design/radiometry.md.
"""
# mypy: disable-error-code="call-arg, var-annotated"
# (mypy counts the typing context among the arguments of intrinsics)

import numpy as np

from ..kernels.jit import inlined, kernel
from ..kernels.predicate.filters import cross, dot


@inlined
def _plus(a, b):
    return a[0] + b[0], a[1] + b[1], a[2] + b[2]


@inlined
def _moved(a, s, u, t, v):
    """a + s u + t v."""
    return a[0] + s * u[0] + t * v[0], a[1] + s * u[1] + t * v[1], a[2] + s * u[2] + t * v[2]


@inlined
def _edge(a, b, n):
    """The integral (2) along the segment from a to b."""
    c = cross(a, b)
    sine = np.sqrt(dot(c, c))
    return np.arctan2(sine, dot(a, b)) * dot(n, c) / sine if sine > 0.0 else 0.0


@inlined
def quad_irradiance(corner, u, v, area, n):
    """Irradiance from the parallelogram with a corner and two edges [Lambert 1760]."""
    a, b, d = corner, _plus(corner, u), _plus(corner, v)
    c = _plus(b, v)
    heights = dot(n, a), dot(n, b), dot(n, c), dot(n, d)
    if max(max(heights[0], heights[1]), max(heights[2], heights[3])) <= 0.0:
        return 0.0
    if min(min(heights[0], heights[1]), min(heights[2], heights[3])) >= 0.0:
        total = _edge(a, b, n) + _edge(b, c, n) + _edge(c, d, n) + _edge(d, a, n)
    else:
        total = _clipped((a, b, c, d), heights, n)
    return 0.5 * abs(total) / area


@kernel
def _clipped(corners, heights, n):
    """The integral around the part of a convex quadrilateral above the horizon, which cuts two of its edges."""
    total, out, back = 0.0, corners[0], corners[0]  # where the boundary goes below the horizon, and comes back
    for k in range(4):
        a, b = corners[k], corners[(k + 1) & 3]
        high, low = heights[k], heights[(k + 1) & 3]
        if high >= 0.0 and low >= 0.0:
            total += _edge(a, b, n)
        elif high >= 0.0 or low >= 0.0:
            share = high / (high - low)
            cut = _moved(a, share, b, -share, a)
            if high >= 0.0:
                total, out = total + _edge(a, cut, n), cut
            else:
                total, back = total + _edge(cut, b, n), cut
    return total + _edge(out, back, n)


@inlined
def disk_irradiance(c, axis, r, n):
    """Irradiance from the disk with centre c, unit axis and radius r > 0."""
    level, h, facing = dot(n, c), dot(axis, c), dot(n, axis)
    if h < 0.0:
        h, facing = -h, -facing
    extent = r * np.sqrt(max(1.0 - facing * facing, 0.0))  # of its heights above the horizon, to both sides of `level`
    if level <= -extent:
        return 0.0
    if level < extent:
        return _clipped_disk(c, axis, r, n)
    d2, r2 = dot(c, c), r * r
    near, far = d2 + r2, d2 - r2
    s = np.sqrt(far * far + 4.0 * r2 * h * h)
    if not s > 0.0:
        return 0.0
    along = 2.0 * h * h / (s + far) if far > 0.0 else 0.5 * (s - far) / r2  # Eq. (3)
    across = 2.0 * h / (s + near)
    return max((along * facing + across * (level - h * facing)) / s, 0.0)


@kernel
def _clipped_disk(c, axis, r, n):
    """`disk_irradiance` of the part above the horizon, whose boundary is an arc and a chord.

    Points of the arc are c + r (u cos t + v sin t), -t0 <= t <= t0; u points upwards.
    """
    facing = dot(n, axis)
    tilt = np.sqrt(1.0 - facing * facing)
    u = (n[0] - facing * axis[0]) / tilt, (n[1] - facing * axis[1]) / tilt, (n[2] - facing * axis[2]) / tilt
    v = cross(axis, u)
    t0 = np.arccos(min(max(-dot(n, c) / (r * tilt), -1.0), 1.0))
    x, y = r * np.cos(t0), r * np.sin(t0)
    arc = _arc(dot(c, u), dot(c, v), dot(c, axis), r, facing, tilt, t0)
    return abs(arc + _edge(_moved(c, x, u, y, v), _moved(c, x, u, -y, v), n)) / (2.0 * np.pi * r * r)


@inlined
def _arc(cu, cv, h, r, facing, tilt, t0):
    """The integral (4) along the arc; with t' = t - phase it is that of (i sin t' + j cos t' + k) / (a + b cos t')."""
    p, phase = np.sqrt(cu * cu + cv * cv), np.arctan2(cv, cu)
    sine, cosine = np.sin(phase), np.cos(phase)
    at_sine, at_cosine = r * facing * cv, r * (facing * cu - tilt * h)
    i, j = at_sine * cosine - at_cosine * sine, at_sine * sine + at_cosine * cosine
    k = r * r * facing
    a, b = p * p + h * h + r * r, 2.0 * r * p
    q = np.sqrt((h * h + (p - r) * (p - r)) * (h * h + (p + r) * (p + r)))  # of a^2 - b^2
    if not q > 0.0:
        return 0.0
    low, high = -t0 - phase, t0 - phase
    turned = _turned(a + q, b, high) - _turned(a + q, b, low)
    of_one = 2.0 * (t0 - b * turned) / q
    of_cosine = 2.0 * (a * turned - t0 * b / (a + q)) / q
    step = (np.cos(high) - np.cos(low)) / (a + b * np.cos(low))
    of_sine = -step * _log1p_over(b * step)
    return i * of_sine + j * of_cosine + k * of_one


@inlined
def _turned(m, b, t):
    """atan(b sin t / (m + b cos t)) / b, also for b = 0."""
    x = np.sin(t) / (m + b * np.cos(t))
    return np.arctan(b * x) / b if b * abs(x) > 1e-9 else x


@inlined
def _log1p_over(x):
    """log(1 + x) / x, also for x = 0."""
    return np.log1p(x) / x if abs(x) > 1e-9 else 1.0
