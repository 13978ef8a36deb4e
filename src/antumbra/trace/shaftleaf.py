"""A block of triangles against the shafts of a tile: cull, cover, and test rays only where neither decides.

With c the centre of the receivers' box, C that of a box of light samples, D = C - c, a = v0 - c, and p, q the edges at v0,
the edge functions of `predicate.filters` along the axis of the shaft are

    e2 = D . (a x p)     e1 = -D . (a x q)     e0 = D . n - e1 - e2       n = p x q

For a receiver c + x and a sample C + y they change, with N the vector that D is multiplied by and g the edge, by

    y . N  -  x . (N + g x D)  -  y . (x x g)

so by at most ry . |N| + rx . |N + g x D| + w |g|, where rx, ry are the half extents of the two boxes and w = sum of
ry_i (rx_j + rx_k). Likewise the distances T = a . n of the receivers from the triangle's plane and F = T - D . n of the
samples change by rx . |n| and ry . |n|. So signs that are sure along the axis hold for all segments of the shaft: it
misses if two edge functions have opposite signs, or T and F the same one; all its segments are blocked if all edge
functions have one sign and T and F opposite ones. This is corner-ray culling [Benthin and Wald 2009, Sec. 4.2] for
shafts whose segments share no origin.

First the 16 triangles of a block are culled side by side against the smallest group of strata that is of interest;
then what is left, one triangle at a time, against the 16 strata side by side; then, for the strata that are left, the
16 rays of each. Rounding: E = 64 u s (span wide + |rx| |D|) bounds the error of e0, e1, e2 of the axis and of any ray
of the shaft, and of their slack (see `predicate.filters`: 60 u |d| s max(|a|, s) for each e; here span >= |d| and wide
>= |a| for all of them); 64 u s^2 (|a| + span) that of T, F and theirs.
"""

import numpy as np

from ..bvh.blocks import ROWS
from ..jit import inlined, kernel
from ..predicate.filters import plane
from ..simd import (
    absolute,
    bits,
    broadcast16,
    fma,
    get,
    load16,
    lowest_bit,
    maximum,
    minimum,
    popcount,
    ptr_at,
    put,
    splat16,
    store,
)
from .aside import put_aside
from .counters import CANDIDATES, COVERED, TRIANGLE_TESTS, TRIANGLES, count
from .lighttable import group_of
from .raytest import Lanes, decide
from .shafts import CAP_ERROR, FAR, NEAR, PLANE, PLANES, D, N, axis_of
from .vec import Vec, abs_dot, abs_dots, broadcasts, cross, crosses, dot, dots, keep, largest, minus, plus, rows

_F = np.float32
_U = _F(64 * 2.0**-24)
_MORE = _F(1.0 + 2.0**-18)  # rounding of sums of slack
_TINY = _F(1e-37)
_ZERO = _F(0.0)
_CP, _CQ, _N, _MIDDLE, _HALF, _T, _K, _KT, _KF, _E, _TE, _WIDE = (16 * i for i in (0, 3, 6, 9, 12, 15, 16, 19, 20, 21, 22, 23))
WORK = 24 * 16  # float32 of scratch memory


@inlined
def _beyond(shafts, at, group, a, p, q, wide):
    """mask16 of the triangles all of whose corners are beyond a plane of the shaft."""
    w = broadcasts(shafts, at + group, N)
    nearest = dot(a, w) + minimum(minimum(dot(p, w), dot(q, w)), splat16(_ZERO))
    return nearest > fma(wide, broadcast16(shafts, at + 4 * N + group), broadcast16(shafts, at + 3 * N + group))


@inlined
def _outside(shafts, group, a, p, q, wide):
    """mask16 of the triangles that are beyond one of the six planes of the shaft."""
    d, zero = broadcasts(shafts, D + group, N), splat16(_ZERO)
    at, on, off = dot(a, d), dot(p, d), dot(q, d)
    error = wide * broadcast16(shafts, CAP_ERROR + group)
    behind = at + maximum(maximum(on, off), zero) < broadcast16(shafts, NEAR + group) - error
    ahead = at + minimum(minimum(on, off), zero) > broadcast16(shafts, FAR + group) + error
    return (
        behind
        | ahead
        | _beyond(shafts, PLANES, group, a, p, q, wide)
        | _beyond(shafts, PLANES + PLANE, group, a, p, q, wide)
        | _beyond(shafts, PLANES + 2 * PLANE, group, a, p, q, wide)
        | _beyond(shafts, PLANES + 3 * PLANE, group, a, p, q, wide)
    )


@inlined
def _slack(n, g_cross_d, receivers, lights, axis, size, e):
    """Slack of one edge function: (without the part of the lights, with it)."""
    common = fma(abs_dots(plus(n, g_cross_d), receivers), splat16(_MORE), fma(size, splat16(_F(2.0) * axis.twist), e))
    return common, fma(abs_dots(n, lights), splat16(_MORE), common)


@inlined
def _keep_box(work, a, p, q):
    """Centre and half extents of the triangles' boxes."""
    zero, half = splat16(_ZERO), _F(0.5)
    x, y, z = minimum(minimum(p.x, q.x), zero), minimum(minimum(p.y, q.y), zero), minimum(minimum(p.z, q.z), zero)
    u, v, w = maximum(maximum(p.x, q.x), zero), maximum(maximum(p.y, q.y), zero), maximum(maximum(p.z, q.z), zero)
    keep(work, _MIDDLE, 16, Vec(a.x + (x + u) * half, a.y + (y + v) * half, a.z + (z + w) * half))
    half *= _MORE
    keep(work, _HALF, 16, Vec((u - x) * half, (v - y) * half, (w - z) * half))


@kernel
def cull_block(tile, block, group, facing, work):
    """Bits of the triangles of a block that some segment of the shaft to a group may meet; more on them in `work`."""
    info, shafts = tile.info, tile.shafts
    c = broadcasts(info, 0, 1)
    a, p, q = minus(rows(block, 0, 16), c), rows(block, 48, 16), rows(block, 96, 16)
    reach, size = largest(a), maximum(largest(p), largest(q))
    receivers = Vec(get(info, 3), get(info, 4), get(info, 5))
    wide = maximum(reach, size) + (receivers.x + receivers.y + receivers.z)
    n, axis = cross(p, q), axis_of(shafts, group)
    floor = fma(wide, splat16(_TINY), splat16(_TINY * (axis.span + _F(1.0))))
    te = fma(size * size * _U, reach + axis.span, floor)
    dn, t = dots(n, axis.d), dot(a, n)
    f = t - dn
    kt = fma(abs_dots(n, receivers), splat16(_MORE), te)
    gf = fma(abs_dots(n, axis.half), splat16(_MORE), te)
    same_side = (minimum(t - kt, f - gf) > _ZERO) | (maximum(t + kt, f + gf) < _ZERO)
    away = dn * _F(facing) > kt + gf
    culled = same_side | away | _outside(shafts, group, a, p, q, wide)
    left = bits(culled) ^ 0xFFFF
    if left == 0:
        return left
    cp, cq = cross(a, p), cross(a, q)
    e = fma(size * _U, fma(wide, splat16(axis.span), splat16(axis.lever)), floor)
    e2, e1 = dots(cp, axis.d), -dots(cq, axis.d)
    e0 = dn - e1 - e2
    p_d, q_d = crosses(p, axis.d), crosses(q, axis.d)
    k2, g2 = _slack(cp, p_d, receivers, axis.half, axis, size, e)
    k1, g1 = _slack(cq, q_d, receivers, axis.half, axis, size, e)
    k0, g0 = _slack(plus(n, minus(cq, cp)), minus(q_d, p_d), receivers, axis.half, axis, size + size, e)
    some_up = maximum(maximum(e0 - g0, e1 - g1), e2 - g2) > _ZERO
    some_down = minimum(minimum(e0 + g0, e1 + g1), e2 + g2) < _ZERO
    left &= bits(some_up & some_down) ^ 0xFFFF
    if left != 0:
        keep(work, _CP, 16, cp)
        keep(work, _CQ, 16, cq)
        keep(work, _N, 16, n)
        _keep_box(work, a, p, q)
        store(work, _T, t)
        store(work, _K, k0)
        store(work, _K + 16, k1)
        store(work, _K + 32, k2)
        store(work, _KT, kt)
        store(work, _KF, te)
        store(work, _E, e)
        store(work, _TE, te)
        store(work, _WIDE, wide)
    return left


@inlined
def _box_beyond(shafts, at, middle, half, wide):
    """mask16 of the strata for which a triangle's box is beyond a plane of their shaft."""
    w = rows(shafts, at + 16, N)
    nearest = dot(w, middle) - fma(
        absolute(w.x), half.x, fma(absolute(w.y), half.y, absolute(w.z) * half.z)
    )
    return nearest > fma(load16(shafts, at + 4 * N + 16), wide, load16(shafts, at + 3 * N + 16))


@inlined
def _strata_outside(shafts, work, i):
    """mask16 of the strata whose shaft has the box of triangle i beyond one of its sides."""
    middle, half, wide = broadcasts(work, _MIDDLE + i, 16), broadcasts(work, _HALF + i, 16), broadcast16(work, _WIDE + i)
    return (
        _box_beyond(shafts, PLANES, middle, half, wide)
        | _box_beyond(shafts, PLANES + PLANE, middle, half, wide)
        | _box_beyond(shafts, PLANES + 2 * PLANE, middle, half, wide)
        | _box_beyond(shafts, PLANES + 3 * PLANE, middle, half, wide)
    )


@inlined
def cull_strata(shafts, work, i, facing):
    """(bits of the strata whose shafts miss triangle i of the block, of those that it blocks whole, sign of all F or 0)."""
    d, half = rows(shafts, D + 16, N), rows(shafts, 3 * N + 16, N)
    cp, cq, n = broadcasts(work, _CP + i, 16), broadcasts(work, _CQ + i, 16), broadcasts(work, _N + i, 16)
    c0 = plus(n, minus(cq, cp))
    dn, e2, e1 = dot(d, n), dot(d, cp), -dot(d, cq)
    e0 = dn - e1 - e2
    more = splat16(_MORE)
    k0 = fma(abs_dot(c0, half), more, broadcast16(work, _K + i))
    k1 = fma(abs_dot(cq, half), more, broadcast16(work, _K + 16 + i))
    k2 = fma(abs_dot(cp, half), more, broadcast16(work, _K + 32 + i))
    kf = fma(abs_dot(n, half), more, broadcast16(work, _KF + i))
    a0, a1, a2, b0, b1, b2 = e0 - k0, e1 - k1, e2 - k2, e0 + k0, e1 + k1, e2 + k2
    t, kt = get(work, _T + i), get(work, _KT + i)
    f = broadcast16(work, _T + i) - dn
    above, below = f > kf, f < -kf
    misses = (maximum(maximum(a0, a1), a2) > _ZERO) & (minimum(minimum(b0, b1), b2) < _ZERO)
    up, down = minimum(minimum(a0, a1), a2) > _ZERO, maximum(maximum(b0, b1), b2) < _ZERO
    miss, cover = bits(misses | _strata_outside(shafts, work, i)), np.int64(0)
    if t > kt:
        miss |= bits(above)
        cover = bits((up | down) & below)
    elif t < -kt:
        miss |= bits(below)
        cover = bits((up | down) & above)
    if facing != 0:
        wrong = bits(up) if facing > 0 else bits(down)
        miss |= wrong
        cover &= ~wrong
    f_side = np.int64(0)
    if bits(above) == 0xFFFF:
        f_side = np.int64(1)
    elif bits(below) == 0xFFFF:
        f_side = np.int64(-1)
    return miss, cover, f_side


@inlined
def lanes_of(tile, block, work, i):
    """`Lanes` of triangle i of a block that `cull_block` has left."""
    a = minus(broadcasts(block, i, 16), rows(tile.origins, 0, 16))
    p, q, n = broadcasts(block, 48 + i, 16), broadcasts(block, 96 + i, 16), broadcasts(work, _N + i, 16)
    return Lanes(cross(a, p), cross(a, q), n, dot(a, n), broadcast16(work, _E + i), broadcast16(work, _TE + i))


@inlined
def test_rays(tile, lanes, s, facing):
    """(bits of the receivers whose segment to stratum s surely meets the triangle, of those float32 cannot say)."""
    d = minus(rows(tile.points, s * 48, 16), rows(tile.origins, 0, 16))
    return decide(d, lanes, facing)


@kernel
def _on_the_lights_side(tile, tree, slot, above, lanes):
    """Bits of those receivers that are, as all of the light, surely on one side of a triangle's plane, in float64.

    For the surface that a tile lies on, and what continues it, float32 cannot say on which side the receivers are.
    """
    f = np.float64
    a, n, error = plane(tree.corners, slot, f(0.0), f(0.0), f(0.0))
    settled = np.int64(0)
    while lanes != 0:
        lane = lowest_bit(lanes)
        lanes &= lanes - 1
        x, y, z = (
            a[0] - f(get(tile.origins, lane)),
            a[1] - f(get(tile.origins, 16 + lane)),
            a[2] - f(get(tile.origins, 32 + lane)),
        )
        t = x * n[0] + y * n[1] + z * n[2]
        bound = error * (abs(x) + abs(y) + abs(z))
        if t > bound if above else t < -bound:
            settled |= np.int64(1) << lane
    return settled


@inlined
def _receivers_to_test(tile, tree, slot, work, i, f_side, valid):
    """The receivers that a triangle may block: not its own, nor those that see its plane from where the light is."""
    receivers = valid & ~bits(load16(tile.faces, 0) == get(tree.prim_ids, slot))
    t, kt = get(work, _T + i), get(work, _KT + i)
    if f_side != 0 and receivers != 0 and abs(t) <= kt:
        receivers &= ~_on_the_lights_side(tile, tree, slot, f_side > 0, receivers)
    return receivers


@kernel
def _rays_of_triangle(tile, tree, block, i, strata, f_side, work, valid, facing, aside, counters):
    """Test a triangle against the rays of some strata; those that have no ray left."""
    numbers, done = ptr_at(tree.blocks, block * (ROWS * 16)), np.int64(0)
    slot = np.int64(get(tree.slots, block * 16 + i))
    receivers = _receivers_to_test(tile, tree, slot, work, i, f_side, valid)
    if receivers == 0:
        return done
    lanes = lanes_of(tile, numbers, work, i)
    while strata != 0:
        s = lowest_bit(strata)
        strata &= strata - 1
        dead = np.int64(get(tile.dead, s))
        count(counters, TRIANGLE_TESTS, 1)
        hit, unsure = test_rays(tile, lanes, s, facing)
        unsure &= receivers & ~dead
        if unsure != 0:
            put_aside(aside, slot, tile.number << 8 | s << 4, 1, unsure)
        hit &= receivers
        if hit & ~dead:
            put(tile.dead, s, dead | hit)
            if (dead | hit) & valid == valid:
                done |= np.int64(1) << s
    return done


@kernel
def _trace_sparse(tile, tree, block, triangles, strata, valid, facing, work, aside, counters):
    """`trace_block` for few strata: each one's own shaft culls the block, and the rays are tested at once."""
    numbers, done = ptr_at(tree.blocks, block * (ROWS * 16)), np.int64(0)
    while strata != 0:
        s = lowest_bit(strata)
        strata &= strata - 1
        left = cull_block(tile, numbers, 16 + s, facing, work) & ((np.int64(1) << triangles) - 1)
        count(counters, CANDIDATES, popcount(left))
        one = np.int64(1) << s
        while left != 0 and done & one == 0:
            i = lowest_bit(left)
            left &= left - 1
            done |= _rays_of_triangle(tile, tree, block, i, one, np.int64(0), work, valid, facing, aside, counters)
    return done


SPARSE = 4


@kernel
def trace_block(tile, tree, block, triangles, strata, valid, facing, work, aside, counters):
    """Test the segments of some strata of a tile against a block; bits of the strata that have none left."""
    count(counters, TRIANGLES, triangles)
    if popcount(strata) <= SPARSE:
        return _trace_sparse(tile, tree, block, triangles, strata, valid, facing, work, aside, counters)
    numbers, done = ptr_at(tree.blocks, block * (ROWS * 16)), np.int64(0)
    left = cull_block(tile, numbers, group_of(strata), facing, work) & ((np.int64(1) << triangles) - 1)
    count(counters, CANDIDATES, popcount(left))
    while left != 0:
        i = lowest_bit(left)
        left &= left - 1
        miss, cover, f_side = cull_strata(tile.shafts, work, i, facing)
        cover &= strata
        count(counters, COVERED, popcount(cover))
        done |= cover
        strata &= ~cover
        tests = strata & ~miss
        if tests != 0:
            done_now = _rays_of_triangle(tile, tree, block, i, tests, f_side, work, valid, facing, aside, counters)
            done |= done_now
            strata &= ~done_now
        if strata == 0:
            break
    return done
