"""The lines of a packet, and the triangles that all of them miss.

Let x0 be a point near which the lines pass, such as the rays' common origin or end. Let p and q be the edges of a
triangle at v0, a = v0 - x0 and n = p x q. For a ray from o along d, with the moment m = d x (o - x0), the edge
functions of `kernels.exact.filters` are

    e2 = d . u - p . m    e1 = d . v + q . m    e0 = d . (n - u - v) - (q - p) . m    u = a x p    v = q x a

Over a packet, d is in a box, and the terms with m are at most 2 s |m|_1 each, where s is the largest component of p and
q. A line misses the triangle if one of the functions is positive and another negative. So all lines miss it if the same
two are, by more than these bounds.

Rounding. With l at least |d|_1, E = 128 u s l max(|a|, s) covers the errors: those of u and v are at most 8 u |a| s in
each component, those of the sum n - u - v at most 36 u s max(|a|, s), and the products with d and the slack add less
than twice that. Directions and moments are rounded too, which their bounds include.
"""

from typing import NamedTuple

import numpy as np

from ...kernels.exact.filters import larger
from ...kernels.jit import inlined
from ...kernels.simd import absolute, bits, fma, load16, maximum, minimum, splat16
from ...kernels.vec3 import Vec3, abs_dot, add3, cross, dot, largest, subtract3
from .wide_traversal import BLOCK_WORDS, DX, LANES, LARGE, OX, first_block, group_of, rays_of_block

_SPREAD = np.float32(2.0**-21)  # of a direction's largest component: rounding of directions and of their bounds
_LEVER = np.float32(2.0**-19)  # of an origin's offset times a direction: rounding of moments
_MORE = np.float32(1.0 + 2.0**-18)  # rounding of sums of slack
_CULL = np.float32(128 * 2.0**-24)  # error of an edge function, per unit of the product of its factors
_TINY = np.float32(1e-37)  # more than the error by underflow of a sum of products
_MOST = np.float32(2.0**100)  # product of factors below which no edge function overflows
_TWICE, _INF = np.float32(2.0), np.float32(np.inf)


class PacketLines(NamedTuple):
    """Bounds of a packet's lines, on both sides of x0; scalars."""

    origin: Vec3  # x0
    middle: Vec3  # of the directions
    half: Vec3  # half extents of the directions
    span: np.float32  # at least the sum of the magnitudes of a direction's components
    lever: np.float32  # at least that of a moment's, direction x (origin - x0); inf: triangles cannot be culled


@inlined
def moments_of(rows, alive, x0):
    """The greatest sums of the magnitudes of a moment's components, a vector; alive: rays (bits) of the blocks.

    x0 : near which the lines pass, (x, y, z)
    """
    moments = splat16(np.float32(0.0))
    while alive:
        b = first_block(alive) * BLOCK_WORDS
        alive &= ~rays_of_block(first_block(alive))
        x, y, z = load16(rows, DX + b), load16(rows, DX + LANES + b), load16(rows, DX + 2 * LANES + b)
        ox, oy = load16(rows, OX + b) - x0[0], load16(rows, OX + LANES + b) - x0[1]
        oz = load16(rows, OX + 2 * LANES + b) - x0[2]
        m = absolute(fma(y, oz, -(z * oy))) + absolute(fma(z, ox, -(x * oz))) + absolute(fma(x, oy, -(y * ox)))
        moments = maximum(moments, m)
    return moments


@inlined
def _middle(low, high, more):
    """(middle, half extent) of an interval; `more`: added to the half extent."""
    middle = np.float32(0.5) * (low + high)
    return middle, larger(high - middle, middle - low) + more


@inlined
def lines_of(d_low, d_high, levers, x0, reach):
    """The `PacketLines` of a packet.

    d_low, d_high : the least and the greatest components of the directions
    levers : the greatest of `moments_of`, and the largest magnitude of a component of origin - x0
    x0 : near which the lines pass, (x, y, z)
    reach : the largest magnitude of a coordinate of x0, the origins and the triangles
    """
    largest_x = larger(abs(d_low[0]), abs(d_high[0]))
    largest_y = larger(abs(d_low[1]), abs(d_high[1]))
    size = larger(larger(largest_x, largest_y), larger(abs(d_low[2]), abs(d_high[2])))
    more = size * _SPREAD
    (x, dx), (y, dy) = _middle(d_low[0], d_high[0], more), _middle(d_low[1], d_high[1], more)
    z, dz = _middle(d_low[2], d_high[2], more)
    span = np.float32(3.0) * size
    lever = (levers[0] + size * levers[1] * _LEVER) * _MORE
    lever = lever if span * reach * reach < _MOST and reach < LARGE else _INF
    return PacketLines(Vec3(x0[0], x0[1], x0[2]), Vec3(x, y, z), Vec3(dx, dy, dz), span, lever)


@inlined
def _edge(n, lines):
    """(middle, slack) of the edge functions n . d of eight triangles over the directions d of a packet."""
    return dot(n, lines.middle), abs_dot(n, lines.half) * _MORE


@inlined
def culled(groups, at, lines):
    """Bits of the triangles of a group that all lines of a packet surely miss."""
    t, x0 = group_of(groups, at), lines.origin
    a, p, q = Vec3(t.x - x0.x, t.y - x0.y, t.z - x0.z), Vec3(t.px, t.py, t.pz), Vec3(t.qx, t.qy, t.qz)
    u, v = cross(a, p), cross(q, a)
    (e2, k2), (e1, k1) = _edge(u, lines), _edge(v, lines)
    e0, k0 = _edge(subtract3(cross(p, q), add3(u, v)), lines)
    wide = maximum(largest(a), t.s)
    floor = (wide + lines.span) * _TINY + _TINY
    error = fma(t.s, wide * (lines.span * _CULL) + _TWICE * lines.lever, floor)
    some_up = maximum(maximum(e0 - k0, e1 - k1), e2 - k2) > error
    some_down = minimum(minimum(e0 + k0, e1 + k1), e2 + k2) < -error
    return bits(some_up & some_down)
