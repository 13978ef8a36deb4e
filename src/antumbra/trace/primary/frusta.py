"""Slab tests of the 16 frusta of a tile of primary rays: 8 x 4 pixels each, the camera as common origin.

A frustum holds the rays o + t d of its pixels; along each axis d_low <= d <= d_high, so it meets the slab [low, high]
of a node's box at t only if o + t d_high >= low and o + t d_low <= high [Benthin and Wald 2009, Sec. 4.1]. Each
condition bounds t from below or above, by the sign of its d. Where all 16 frusta go the same way along every
axis, two planes of a slab decide (`Uniform`); else all four bounds are kept, and those that do not bind are at 0 or
infinity.

Conservative in float32: a bound is fma(plane, r, k) with r = 1 / d and k = -o r, wrong by at most 7u (|t| + |k|) with
u the unit roundoff. `_PAD` |k| is added to k once, outwards; `GROW` covers the rest when a lower bound is compared
with an upper one. A |d| below a tiny limit is taken for one of that size that bounds t from below.
"""

from typing import NamedTuple

import numpy as np

from ...kernels.jit import inlined, kernel
from ...kernels.simd import absolute, bits, broadcast16, fma, load16, maximum, minimum, put, select, splat16, store
from ..slabs import Bound, Uniform

_F = np.float32
GROW = _F(1.0 + 2.0**-20)
_PAD = _F(12 * 2.0**-24)
_LOW = _F(1e-7)  # directions below this share of the longest count as zero
_ZERO, _INFINITE = _F(0.0), _F(np.inf)
LOW, HIGH, MIXED = 0, 48, 96  # rows of 16: d_low (x, y, z), d_high; eight rows for the bounds of each axis
FLOATS = MIXED + 3 * 128


class Uniforms(NamedTuple):
    """All axes of a tile whose frusta go one way along each."""

    x: Uniform
    y: Uniform
    z: Uniform


@kernel
def bound_directions(rays, error, x0, y0, slabs):
    """Write d_low and d_high of the frusta of the tile at pixel (x0, y0).

    error: (3,) float64, how far `pixel_direction` is from the real direction at most. Frusta that lie beyond the
    picture are bounded too.
    """
    for axis in range(3):
        dx, dy = rays.dx[axis], rays.dy[axis]
        half = 3.5 * abs(dx) + 1.5 * abs(dy) + 2.0 * error[axis]
        for f in range(16):
            middle = rays.corner[axis] + (x0 + 8 * (f & 3) + 4.0) * dx + (y0 + 4 * (f >> 2) + 2.0) * dy
            put(slabs, LOW + 16 * axis + f, middle - half)
            put(slabs, HIGH + 16 * axis + f, middle + half)


@inlined
def _limit(slabs):
    """The |d| below which a direction counts as zero, in each lane."""
    d = splat16(_F(1e-30))
    for row in range(6):
        d = maximum(d, absolute(load16(slabs, 16 * row)) * _LOW)
    return d


@inlined
def _bounds(o, d):
    """(r, k of a lower bound, k of an upper bound) of t = (plane - o) / d."""
    r = _F(1.0) / d
    k = r * -o
    pad = absolute(k) * _PAD
    return r, k - pad, k + pad


@inlined
def _way(slabs, axis, limit):
    """1 if all frusta go up along an axis, -1 if all go down, else 0."""
    if bits(load16(slabs, LOW + 16 * axis) >= limit) == 0xFFFF:
        return 1
    return -1 if bits(load16(slabs, HIGH + 16 * axis) <= -limit) == 0xFFFF else 0


@inlined
def _uniform(slabs, axis, o, way):
    low, high = load16(slabs, LOW + 16 * axis), load16(slabs, HIGH + 16 * axis)
    up = way > 0
    r, near, _ = _bounds(o, high if up else low)
    s, _, far = _bounds(o, low if up else high)
    return Uniform(Bound(r, near), Bound(s, far), 0 if up else 2, 2 if up else 0)


@inlined
def _keep(slabs, at, there, r, k, otherwise):
    store(slabs, at, select(there, r, splat16(_ZERO)))
    store(slabs, at + 16, select(there, k, splat16(otherwise)))


@inlined
def _mix(slabs, axis, o, limit):
    """Write the four bounds of one axis: lower and upper bounds by the lower planes, then by the upper planes."""
    low, high, at = load16(slabs, LOW + 16 * axis), load16(slabs, HIGH + 16 * axis), MIXED + 128 * axis
    up, down = high > -limit, low < limit
    r, near, far = _bounds(o, select(up, maximum(high, limit), high))
    _keep(slabs, at, up, r, near, _ZERO)
    _keep(slabs, at + 32, ~up, r, far, _INFINITE)
    r, near, far = _bounds(o, select(down, minimum(low, -limit), low))
    _keep(slabs, at + 64, down, r, near, _ZERO)
    _keep(slabs, at + 96, ~down, r, far, _INFINITE)


@inlined
def prepare(slabs, eye):
    """(whether the frusta go one way along each axis, `Uniforms` if so); else their bounds are written to `slabs`."""
    limit = _limit(slabs)
    ways = (_way(slabs, 0, limit), _way(slabs, 1, limit), _way(slabs, 2, limit))
    one_way = ways[0] != 0 and ways[1] != 0 and ways[2] != 0
    if not one_way:
        _mix(slabs, 0, eye.x, limit)
        _mix(slabs, 1, eye.y, limit)
        _mix(slabs, 2, eye.z, limit)
    return one_way, Uniforms(
        _uniform(slabs, 0, eye.x, ways[0]), _uniform(slabs, 1, eye.y, ways[1]), _uniform(slabs, 2, eye.z, ways[2])
    )


@inlined
def _at(bound, nodes, plane):
    return fma(broadcast16(nodes, plane), bound.r, bound.k)


@inlined
def meet_uniform(nodes, at, u, far):
    """(entry t, bits of the frusta that enter before `far`) of the box whose lower x is element `at` of `nodes`."""
    x, y, z = u.x, u.y, u.z
    near = maximum(
        maximum(_at(x.near, nodes, at + x.near_plane), _at(y.near, nodes, at + 4 + y.near_plane)),
        maximum(_at(z.near, nodes, at + 8 + z.near_plane), splat16(_ZERO)),
    )
    leave = minimum(
        minimum(_at(x.far, nodes, at + x.far_plane), _at(y.far, nodes, at + 4 + y.far_plane)),
        minimum(_at(z.far, nodes, at + 8 + z.far_plane), far),
    )
    return near, bits(near <= leave * GROW)


@inlined
def _line(slabs, at, plane):
    return fma(plane, load16(slabs, at), load16(slabs, at + 16))


@inlined
def meet_mixed(nodes, at, slabs, far):
    """The same for frusta of any directions."""
    near, leave = splat16(_ZERO), far
    for axis in range(3):
        k, low, high = MIXED + 128 * axis, broadcast16(nodes, at + 4 * axis), broadcast16(nodes, at + 4 * axis + 2)
        near = maximum(near, maximum(_line(slabs, k, low), _line(slabs, k + 64, high)))
        leave = minimum(leave, minimum(_line(slabs, k + 32, low), _line(slabs, k + 96, high)))
    return near, bits(near <= leave * GROW)
