"""Cull and cover: find triangles that shafts or beams surely miss, and triangles that surely block all segments.

Let c be the centre of the receivers' box, C the centre of a box of light samples, and D = C - c. Let p and q be the
edges at v0, and a = v0 - c. Along the axis of the shaft, the edge functions of `predicate.filters` are

    e2 = D . (a x p)     e1 = -D . (a x q)     e0 = D . n - e1 - e2       n = p x q

Let N be the vector that D is multiplied by, and g the edge. For a receiver c + x and a sample C + y, an edge function
changes by

    y . N  -  x . (N + g x D)  -  y . (x x g)

This is at most ry . |N| + rx . |N + g x D| + w |g|, the *slack*. Here rx and ry are the half extents of the two boxes,
and w is the sum of ry_i (rx_j + rx_k). The distances from the triangle's plane are T = a . n for the receivers and
F = T - D . n for the samples. They change by at most rx . |n| and ry . |n|.

So signs that are sure along the axis hold for all segments of the shaft:

- The shaft misses the triangle if two edge functions have opposite signs, or if T and F have the same sign.
- The triangle blocks all segments if all edge functions have one sign, and T and F have opposite signs.

This is corner-ray culling [Benthin and Wald 2009, Sec. 4.2] for shafts whose segments share no origin. For a beam x is
zero, and the slack is exactly ry . |N|. The shafts belong to a tile's groups or strata, or to 16 tiles.

Rounding: let E = 64 u s (span wide + |rx| |D|). E bounds the errors of e0, e1 and e2, along the axis and along any ray
of the shaft. It also bounds the errors of their slack. It follows from the bound 60 u |d| s max(|a|, s) for each e in
`predicate.filters`, because span >= |d| and wide >= |a| for all rays. In the same way 64 u s^2 (|a| + span) bounds the
errors of T and F, and of their slack.
"""

from typing import NamedTuple

import numpy as np

from ...kernels.jit import inlined, kernel
from ...kernels.simd import bits, broadcast16, fma, get, load16, maximum, minimum, splat16, store
from ...kernels.vec import Vec, abs_dot, broadcasts, cross, dot, keep, largest, minus, plus, rows
from ..raytest import UNITS, Lanes, error_bounds, splats
from ..shafts import PLANE, PLANES, SPAN, D, N, axis_of

_F = np.float32
_U = _F(UNITS * 2.0**-24)
_MORE = _F(1.0 + 2.0**-18)  # rounding of sums of slack
_TINY = _F(1e-37)
_ZERO = _F(0.0)
_CP, _CQ, _N, _T, _K, _KT, _KF, _E, _TE, _WIDE, _SIZE = (16 * i for i in (0, 3, 6, 9, 10, 13, 14, 15, 16, 17, 18))
CULL_WORK = 19 * 16  # float32 of scratch memory


@inlined
def _beyond(shafts, at, group, a, p, q, wide):
    """mask16 of the triangles that lie wholly beyond a plane of the shaft."""
    w = broadcasts(shafts, at + group, N)
    nearest = dot(a, w) + minimum(minimum(dot(p, w), dot(q, w)), splat16(_ZERO))
    return nearest > fma(wide, broadcast16(shafts, at + 4 * N + group), broadcast16(shafts, at + 3 * N + group))


@inlined
def _outside(shafts, group, a, p, q, wide):
    """mask16 of the triangles that lie wholly beyond one of the four planes of the shaft."""
    return (
        _beyond(shafts, PLANES, group, a, p, q, wide)
        | _beyond(shafts, PLANES + PLANE, group, a, p, q, wide)
        | _beyond(shafts, PLANES + 2 * PLANE, group, a, p, q, wide)
        | _beyond(shafts, PLANES + 3 * PLANE, group, a, p, q, wide)
    )


@inlined
def _slack(n, g_cross_d, receivers, lights, twist, e):
    """Slack of one edge function: (without the part of the lights, with it)."""
    # Eq. (6) of docs/design/multifrusta.md
    common = fma(abs_dot(plus(n, g_cross_d), receivers), splat16(_MORE), twist + e)
    return common, fma(abs_dot(n, lights), splat16(_MORE), common)


@inlined
def _edges(cp, cq, n, p, q, dn, d, half, receivers, twist, e):
    """Edge functions along d (3), their slack without the part of the lights (3), and with it (3)."""
    # Eq. (5) of docs/design/multifrusta.md
    e2, e1 = dot(cp, d), -dot(cq, d)
    p_d, q_d = cross(p, d), cross(q, d)
    k2, g2 = _slack(cp, p_d, receivers, half, twist, e)
    k1, g1 = _slack(cq, q_d, receivers, half, twist, e)
    k0, g0 = _slack(plus(n, minus(cq, cp)), minus(q_d, p_d), receivers, half, twist + twist, e)
    return Vec(dn - e1 - e2, e1, e2), Vec(k0, k1, k2), Vec(g0, g1, g2)


@kernel
def cull_block(tile, numbers, group, facing, work):
    """Bits of a block's triangles that some segment of the shaft to a group may meet. Write their numbers to `work`."""
    info, shafts = tile.info, tile.shafts
    c = broadcasts(info, 0, 1)
    a, p, q = minus(rows(numbers, 0, 16), c), rows(numbers, 48, 16), rows(numbers, 96, 16)
    reach, size = largest(a), maximum(largest(p), largest(q))
    receivers = broadcasts(info, 3, 1)
    wide = maximum(reach, size) + (receivers.x + receivers.y + receivers.z)
    n, axis, span = cross(p, q), axis_of(shafts, group), get(shafts, SPAN + 1)
    floor = fma(wide, splat16(_TINY), splat16(_TINY * (span + _F(1.0))))
    te = fma(size * size * _U, reach + span, floor)
    d, half = splats(axis.d), splats(axis.half)
    dn, t = dot(n, d), dot(a, n)
    f = t - dn
    kt = fma(abs_dot(n, receivers), splat16(_MORE), te)
    gf = fma(abs_dot(n, half), splat16(_MORE), te)
    same_side = (minimum(t - kt, f - gf) > _ZERO) | (maximum(t + kt, f + gf) < _ZERO)
    away = dn * _F(facing) > kt + gf
    culled = same_side | away | _outside(shafts, group, a, p, q, wide)
    left = bits(culled) ^ 0xFFFF
    if left == 0:
        return left
    cp, cq = cross(a, p), cross(a, q)
    e = fma(size * _U, fma(wide, splat16(span), splat16(axis.lever)), floor)
    twist = size * (_F(2.0) * axis.twist)
    on, k, g = _edges(cp, cq, n, p, q, dn, d, half, receivers, twist, e)
    some_up = maximum(maximum(on.x - g.x, on.y - g.y), on.z - g.z) > _ZERO
    some_down = minimum(minimum(on.x + g.x, on.y + g.y), on.z + g.z) < _ZERO
    left &= bits(some_up & some_down) ^ 0xFFFF
    if left != 0:
        keep(work, _CP, 16, cp)
        keep(work, _CQ, 16, cq)
        keep(work, _N, 16, n)
        store(work, _T, t)
        keep(work, _K, 16, k)
        store(work, _KT, kt)
        store(work, _KF, te)
        store(work, _E, e)
        store(work, _TE, te)
        store(work, _WIDE, wide)
        store(work, _SIZE, size)
    return left


@inlined
def _strata_beyond(shafts, at, a, p, q, wide):
    """mask16 of the strata whose shaft has a triangle, given in all lanes, wholly beyond one plane."""
    w = rows(shafts, at + 16, N)
    nearest = dot(w, a) + minimum(minimum(dot(w, p), dot(w, q)), splat16(_ZERO))
    return nearest > fma(load16(shafts, at + 4 * N + 16), wide, load16(shafts, at + 3 * N + 16))


@inlined
def _strata_outside(tile, numbers, work, i):
    """mask16 of the strata whose shaft has triangle i wholly beyond one of its four sides."""
    shafts, wide = tile.shafts, broadcast16(work, _WIDE + i)
    a = minus(broadcasts(numbers, i, 16), broadcasts(tile.info, 0, 1))
    p, q = broadcasts(numbers, 48 + i, 16), broadcasts(numbers, 96 + i, 16)
    return (
        _strata_beyond(shafts, PLANES, a, p, q, wide)
        | _strata_beyond(shafts, PLANES + PLANE, a, p, q, wide)
        | _strata_beyond(shafts, PLANES + 2 * PLANE, a, p, q, wide)
        | _strata_beyond(shafts, PLANES + 3 * PLANE, a, p, q, wide)
    )


class Verdict(NamedTuple):
    """The certain results for 16 shafts and a triangle: bits of the lanes."""

    miss: int  # no segment meets the triangle
    cover: int  # all segments are blocked
    above: int  # all targets lie on the side of the triangle's plane that its normal points away from
    below: int  # all targets lie on the other side


@inlined
def _verdict(e0, e1, e2, k0, k1, k2, t, kt, f, kf, facing):
    """`Verdict` from edge functions e0, e1, e2, distances t, f of both ends from the plane, and the slack of each.

    k0, k1, k2, kt, kf : slack of the edge functions, of t, and of f
    """
    a0, a1, a2, b0, b1, b2 = e0 - k0, e1 - k1, e2 - k2, e0 + k0, e1 + k1, e2 + k2
    above, below, ahead, behind = f > kf, f < -kf, t > kt, t < -kt
    up, down = minimum(minimum(a0, a1), a2) > _ZERO, maximum(maximum(b0, b1), b2) < _ZERO
    mixed = (maximum(maximum(a0, a1), a2) > _ZERO) & (minimum(minimum(b0, b1), b2) < _ZERO)
    miss = bits(mixed | (above & ahead) | (below & behind))
    cover = bits((up | down) & ((above & behind) | (below & ahead)))
    if facing != 0:
        wrong = bits(up) if facing > 0 else bits(down)
        miss |= wrong
        cover &= ~wrong
    return Verdict(miss, cover, bits(above), bits(below))


@inlined
def cull_strata(tile, numbers, work, i, facing):
    """`Verdict` on the shafts of all strata and triangle i of the block."""
    shafts = tile.shafts
    d, half = rows(shafts, D + 16, N), rows(shafts, 3 * N + 16, N)
    cp, cq, n = broadcasts(work, _CP + i, 16), broadcasts(work, _CQ + i, 16), broadcasts(work, _N + i, 16)
    c0 = plus(n, minus(cq, cp))
    # Eq. (5) of docs/design/multifrusta.md
    dn, e2, e1 = dot(d, n), dot(d, cp), -dot(d, cq)
    e0 = dn - e1 - e2
    more = splat16(_MORE)
    k0 = fma(abs_dot(c0, half), more, broadcast16(work, _K + i))
    k1 = fma(abs_dot(cq, half), more, broadcast16(work, _K + 16 + i))
    k2 = fma(abs_dot(cp, half), more, broadcast16(work, _K + 32 + i))
    kf = fma(abs_dot(n, half), more, broadcast16(work, _KF + i))
    t, kt = broadcast16(work, _T + i), broadcast16(work, _KT + i)
    v = _verdict(e0, e1, e2, k0, k1, k2, t, kt, t - dn, kf, facing)
    return Verdict(v.miss | bits(_strata_outside(tile, numbers, work, i)), v.cover, v.above, v.below)


@inlined
def cull_beams(d, half, lanes, facing):
    """`Verdict` on beams along d with half extents `half` at the end: 16 beams and a triangle, or the reverse."""
    cp, qc, n, more = lanes.cp, lanes.qc, lanes.n, splat16(_MORE)
    # Eq. (5) of docs/design/multifrusta.md
    dn, e2, e1 = dot(d, n), dot(d, cp), dot(d, qc)
    k0 = fma(abs_dot(minus(n, plus(qc, cp)), half), more, lanes.e)
    k1, k2 = fma(abs_dot(qc, half), more, lanes.e), fma(abs_dot(cp, half), more, lanes.e)
    kf = fma(abs_dot(n, half), more, lanes.te)
    return _verdict(dn - e1 - e2, e1, e2, k0, k1, k2, lanes.t, lanes.te, lanes.t - dn, kf, facing)


@inlined
def cull_tiles(boxes, targets, numbers, work, i, facing):
    """`Verdict` on the shafts of 16 tiles and triangle i of a block, which `cull_block` has kept for all tiles.

    boxes, targets : rows of middles (3) and half extents (3): boxes of receivers, and boxes of samples
    """
    o, receivers, half = rows(boxes, 0, 16), rows(boxes, 48, 16), rows(targets, 48, 16)
    d, a = minus(rows(targets, 0, 16), o), minus(broadcasts(numbers, i, 16), o)
    p, q, n = broadcasts(numbers, 48 + i, 16), broadcasts(numbers, 96 + i, 16), broadcasts(work, _N + i, 16)
    e, te = broadcast16(work, _E + i), broadcast16(work, _TE + i)
    twist = half.x * (receivers.y + receivers.z) + half.y * (receivers.x + receivers.z)
    twist = (twist + half.z * (receivers.x + receivers.y)) * (_F(2.0) * get(work, _SIZE + i))
    dn, t = dot(n, d), dot(a, n)
    on, _, g = _edges(cross(a, p), cross(a, q), n, p, q, dn, d, half, receivers, twist, e)
    kt, kf = fma(abs_dot(n, receivers), splat16(_MORE), te), fma(abs_dot(n, half), splat16(_MORE), te)
    return _verdict(on.x, on.y, on.z, g.x, g.y, g.z, t, kt, t - dn, kf, facing)


@inlined
def plane_of(work, i):
    """(distance of the receivers' middle from the plane of triangle i of the block, slack for all receivers)."""
    return get(work, _T + i), get(work, _KT + i)


@inlined
def triangle_size(work, i):
    """The largest component of the edges of triangle i of the block, in all lanes."""
    return broadcast16(work, _SIZE + i)


@inlined
def triangle_lanes(origins, numbers, work, i):
    """`Lanes` of triangle i of a block, which `cull_block` has kept, for rays from 16 origins."""
    a = minus(broadcasts(numbers, i, 16), origins)
    p, q, n = broadcasts(numbers, 48 + i, 16), broadcasts(numbers, 96 + i, 16), broadcasts(work, _N + i, 16)
    return Lanes(cross(a, p), cross(q, a), n, dot(a, n), broadcast16(work, _E + i), broadcast16(work, _TE + i))


@inlined
def receiver_lanes(tile, numbers, r):
    """`Lanes` of the 16 triangles of a block for rays from receiver r."""
    return block_lanes(broadcasts(tile.origins, r, 16), numbers, broadcast16(tile.shafts, SPAN + 1))


@inlined
def block_lanes(origin, numbers, span):
    """`Lanes` of the 16 triangles of a block for rays from an origin, given in all lanes.

    span : f32x16, at least the sum of the magnitudes of a ray's components
    """
    a, p, q = minus(rows(numbers, 0, 16), origin), rows(numbers, 48, 16), rows(numbers, 96, 16)
    n = cross(p, q)
    e, te = error_bounds(largest(a), maximum(largest(p), largest(q)), span)
    return Lanes(cross(a, p), cross(q, a), n, dot(a, n), e, te)
