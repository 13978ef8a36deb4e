"""The shaft of one thread on a device: its tests against the boxes of nodes, and against triangles.

They are the CPU's, with its bounds (`descent`, `frusta.shaft_culling`): functions of vectors, which serve here with
vectors of one lane. A shaft that float32 may not hold meets every box, and decides about no triangle.
"""

from typing import NamedTuple

import numpy as np

from ...bvh.nodes import line_at
from ...kernels.device import load4_aligned
from ...kernels.exact.filters import larger, max_magnitude, single_error_unit, smaller
from ...kernels.jit import F32Lanes, F32x4, inlined
from ...kernels.simd import (
    any_lane,
    extract,
    fma,
    mask_from_bits4,
    maximum,
    minimum,
    select,
    splat1,
    splat4,
)
from ...kernels.vec3 import Vec3, abs_dot, cross, dot, largest, middles_and_halves, subtract3, total
from ..descent import Shafts, least_direction, mixed_axis
from ..frusta.shaft_culling import EDGE_UNIT, MORE, UNDERFLOW, Verdict, edges_along, verdict
from ..rays.wide_traversal import largest_of, triangles_fit

_F = np.float32
_ZERO, _ONE = _F(0.0), _F(1.0)


class Ends(NamedTuple):
    """Bounds of both ends of a shaft's segments; tuples of three float32."""

    o_low: tuple[float, float, float]
    o_high: tuple[float, float, float]
    l_low: tuple[float, float, float]
    l_high: tuple[float, float, float]
    shortest: float  # the least of the largest components of the segments' directions


class _Lines(NamedTuple):
    """A shaft prepared for the planes of two boxes along one axis. Lanes: both lower planes, then both upper ones."""

    r: F32x4  # t = r plane + k
    k: F32x4
    enters: F32x4  # mask: t bounds the shaft's part in the box from below


class DeviceShaft(NamedTuple):
    """A shaft prepared for boxes and triangles. Vectors of one lane, unless it says otherwise."""

    x: _Lines
    y: _Lines
    z: _Lines
    centre: Vec3  # of the receivers' box
    receivers: Vec3  # half extents of the receivers' box
    d: Vec3  # from there to the centre of the samples' box
    half: Vec3  # half extents of the samples' box
    twist: F32Lanes  # as in `shafts.Axis`, like the next two
    span: F32Lanes
    lever: F32Lanes
    fits: bool  # float32 holds the shaft
    unit: F32Lanes  # of `FilterRays`, for all segments of the shaft, like the next
    floor: F32Lanes


@inlined
def _ones(v):
    return Vec3(splat1(v[0]), splat1(v[1]), splat1(v[2]))


@inlined
def _lines_of(o_low, o_high, d_low, d_high, limit, fits):
    """`_Lines` of one axis."""
    m, up, down = mixed_axis(o_low, o_high, d_low, d_high, limit, False), d_high > -limit, d_low < limit
    zero, lower_planes = splat4(_ZERO), mask_from_bits4(3)
    r = select(
        lower_planes,
        splat4(extract(select(up, m.near_low.r, m.far_low.r), 0)),
        splat4(extract(select(down, m.near_high.r, m.far_high.r), 0)),
    )
    k = select(
        lower_planes,
        splat4(extract(select(up, m.near_low.k, m.far_low.k), 0)),
        splat4(extract(select(down, m.near_high.k, m.far_high.k), 0)),
    )
    every = ~splat4(fits)
    enters = (lower_planes & splat4(any_lane(up))) | (~lower_planes & splat4(any_lane(down)))
    return _Lines(select(every, zero, r), select(every, zero, k), every | enters)


@inlined
def shaft_of(tree, ends):
    """The `DeviceShaft` of segments between two boxes; ends: Ends."""
    low, high, l_low, l_high = _ones(ends.o_low), _ones(ends.o_high), _ones(ends.l_low), _ones(ends.l_high)
    d_low, d_high = subtract3(l_low, low), subtract3(l_high, high)
    s = Shafts(
        low.x, low.y, low.z, high.x, high.y, high.z, d_low.x, d_low.y, d_low.z, d_high.x, d_high.y, d_high.z
    )  # fmt: skip
    size = larger(
        larger(max_magnitude(ends.o_low), max_magnitude(ends.o_high)),
        larger(max_magnitude(ends.l_low), max_magnitude(ends.l_high)),
    )
    reach = larger(size, largest_of(tree.reach))
    limit = least_direction(s)
    (centre, receivers), (middle, half) = middles_and_halves(low, high), middles_and_halves(l_low, l_high)
    d = subtract3(middle, centre)
    d1, x1, y1 = total(d), receivers.x + receivers.y + receivers.z, half.x + half.y + half.z
    twist = half.x * (receivers.y + receivers.z) + half.y * (receivers.x + receivers.z)
    span = d1 + (y1 + x1) * _F(2.0)
    fits = triangles_fit(ends.shortest, reach) and triangles_fit(extract(span, 0), reach)
    unit, floor = single_error_unit(fits, extract(span, 0), reach)
    return DeviceShaft(
        _lines_of(low.x, high.x, d_low.x, d_high.x, limit, fits),
        _lines_of(low.y, high.y, d_low.y, d_high.y, limit, fits),
        _lines_of(low.z, high.z, d_low.z, d_high.z, limit, fits),
        centre,
        receivers,
        d,
        half,
        twist + half.z * (receivers.x + receivers.y),
        span,
        d1 * x1,
        fits,
        splat1(unit),
        splat1(floor),
    )


@inlined
def _interval(nodes, at, lines):
    """(bounds of t from below, from above) by the planes of both boxes along one axis."""
    t = fma(load4_aligned(nodes, at), lines.r, lines.k)
    return select(lines.enters, t, splat4(_ZERO)), select(lines.enters, splat4(_ONE), t)


@inlined
def enter_boxes(nodes, node, shaft):
    """Whether a shaft meets each child's box: (left, right, whether it enters the left one first)."""
    at = line_at(node)
    (x0, x1), (y0, y1), (z0, z1) = (
        _interval(nodes, at, shaft.x),
        _interval(nodes, at + 4, shaft.y),
        _interval(nodes, at + 8, shaft.z),
    )
    near, far = maximum(maximum(x0, y0), maximum(z0, _ZERO)), minimum(minimum(x1, y1), minimum(z1, _ONE))
    left, right = larger(extract(near, 0), extract(near, 2)), larger(extract(near, 1), extract(near, 3))
    return (
        left <= smaller(extract(far, 0), extract(far, 2)),
        right <= smaller(extract(far, 1), extract(far, 3)),
        left <= right,
    )


@inlined
def cull_triangle(shaft, t, facing):
    """`Verdict` on a shaft and a triangle, whose bits are 0 or 1; t: FilterTriangles, facing: a value of CULL_FACES."""
    if not shaft.fits:
        return Verdict(0, 0, 0, 0)
    a = subtract3(Vec3(t.x, t.y, t.z), shaft.centre)
    p, q, size, reach = Vec3(t.px, t.py, t.pz), Vec3(t.qx, t.qy, t.qz), t.s, largest(a)
    wide = maximum(reach, size) + (shaft.receivers.x + shaft.receivers.y + shaft.receivers.z)
    floor = fma(wide, UNDERFLOW, (shaft.span + _ONE) * UNDERFLOW)
    te = fma(size * size * EDGE_UNIT, reach + shaft.span, floor)
    e = fma(size * EDGE_UNIT, fma(wide, shaft.span, shaft.lever), floor)
    n = cross(p, q)
    dn, height = dot(n, shaft.d), dot(a, n)
    twist = size * (shaft.twist * _F(2.0))
    cp, cq = cross(a, p), cross(a, q)
    on, _, g = edges_along(cp, cq, n, p, q, dn, shaft.d, shaft.half, shaft.receivers, twist, e)
    kt, kf = fma(abs_dot(n, shaft.receivers), MORE, te), fma(abs_dot(n, shaft.half), MORE, te)
    return verdict(on.x, on.y, on.z, g.x, g.y, g.z, height, kt, height - dn, kf, facing)
