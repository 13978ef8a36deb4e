"""Culling and covering: triangles that shafts or beams surely miss, and triangles that surely block all segments.

A block of triangles is tested against a tile by shafts or beams first; rays are tested only where neither decides.

Triangles. Let c be the centre of the receivers' box, C the centre of a box of light samples, and D = C - c. Let p and q
be the edges at v0, and a = v0 - c. Along the axis of the shaft, the edge functions of `predicate.filters` are

    e2 = D . (a x p)     e1 = -D . (a x q)     e0 = D . n - e1 - e2       n = p x q

Let N be the vector by which D is multiplied, and g the edge. For a receiver c + x and a sample C + y, an edge function
changes by

    y . N  -  x . (N + g x D)  -  y . (x x g)

This is at most ry . |N| + rx . |N + g x D| + w |g|, the *slack*. Here rx and ry are the half extents of the two boxes,
and w is the sum of ry_i (rx_j + rx_k). The distances from the triangle's plane are T = a . n for the receivers and F =
T - D . n for the samples. They change by at most rx . |n| and ry . |n|.

So signs that exceed the slack along the axis hold for all segments of the shaft:

- The shaft misses the triangle if two edge functions have opposite signs, or if T and F have the same sign.
- The triangle blocks all segments if all edge functions have one sign, and T and F have opposite signs.

This is corner-ray culling [Benthin and Wald 2009, Sec. 4.2] for shafts whose segments share no origin. For a beam, x is
zero, and the slack is exactly ry . |N|. The shafts belong to a tile's groups or strata, or to 16 tiles.

Rounding. E = 64 u s (span wide + |rx| |D|) bounds the errors of e0, e1 and e2, along the axis and along any ray of the
shaft, including the errors of their slack. It follows from the bound 60 u |d| s max(|a|, s) for each e in
`predicate.filters`, because span >= |d| and wide >= |a| for all rays. In the same way, 64 u s^2 (|a| + span) bounds the
errors of T and F, and of their slack.

Blocks. Beams are narrower near the receivers, and shafts of strata are narrower near the light; `is_near` chooses
between them per block. The chosen 16 are first tested against the block's box.

- If few of them meet the box, each is tested against the 16 triangles side by side.
- Otherwise the triangles are culled side by side against one shaft, to the smallest group that contains all live
  strata. Each remaining triangle is then tested against the 16 beams or strata side by side.

A pair that neither misses nor covers is tested ray by ray. A vector holds 16 samples of one receiver, or 16 receivers
and one stratum. If few rays of a stratum meet the block's box, each of them is tested against the 16 triangles.
"""

from typing import NamedTuple

import numpy as np

from ...bvh.nodes import bounds_at
from ...kernels.exact.filters import plane
from ...kernels.jit import inlined, kernel
from ...kernels.simd import (
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
    reduce_and,
    splat16,
    store,
)
from ...kernels.vec3 import Vec3, abs_dot, add3, broadcasts, cross, dot, largest, rows, splats, store3, subtract3
from ..counters import CANDIDATES, COVERED, TRIANGLE_TESTS, TRIANGLES, count
from ..light_table import group_of
from ..shafts import (
    PLANE,
    PLANES,
    SPAN,
    D,
    N,
    axis_of,
    beam_of,
    beams_in_box,
    beams_of,
    box_at,
    is_near,
    rays_in_box,
    strata_in_box,
)
from ..tile import finished_strata, with_blocked
from ..triangle_tests import (
    LANES,
    UNITS,
    Block,
    Lanes,
    blocks_ray,
    decide,
    defer,
    error_bounds,
    numbers_of,
    slot_of,
    store_lanes,
    stored_lane,
)

# --- Culling and covering ---------------------------------------------------------------------------------------------


_F = np.float32
EDGE_UNIT = _F(UNITS * 2.0**-24)  # error of an edge function, per unit of the product of its factors
MORE = _F(1.0 + 2.0**-18)  # rounding of sums of slack
UNDERFLOW = _F(1e-37)  # more than the error by underflow of a sum of products
_ZERO = _F(0.0)
_CP, _CQ, _N, _T, _K, _KT, _KF, _E, _TE, _WIDE, _SIZE = (16 * i for i in (0, 3, 6, 9, 10, 13, 14, 15, 16, 17, 18))
CULL_WORK = 19 * 16  # float32 of scratch memory


@inlined
def _beyond(shafts, at, group, a, p, q, wide):
    """mask16 of the triangles that lie entirely beyond a plane of the shaft."""
    w = broadcasts(shafts, at + group, N)
    nearest = dot(a, w) + minimum(minimum(dot(p, w), dot(q, w)), splat16(_ZERO))
    return nearest > fma(wide, broadcast16(shafts, at + 4 * N + group), broadcast16(shafts, at + 3 * N + group))


@inlined
def _outside(shafts, group, a, p, q, wide):
    """mask16 of the triangles that lie entirely beyond one of the four planes of the shaft."""
    return (
        _beyond(shafts, PLANES, group, a, p, q, wide)
        | _beyond(shafts, PLANES + PLANE, group, a, p, q, wide)
        | _beyond(shafts, PLANES + 2 * PLANE, group, a, p, q, wide)
        | _beyond(shafts, PLANES + 3 * PLANE, group, a, p, q, wide)
    )


@inlined
def _slack(n, g_cross_d, receivers, lights, twist, e):
    """Slack of one edge function: (without the contribution of the lights, with it)."""
    # Eq. (6) of docs/design/multifrusta.md
    common = fma(abs_dot(add3(n, g_cross_d), receivers), MORE, twist + e)
    return common, fma(abs_dot(n, lights), MORE, common)


@inlined
def edges_along(cp, cq, n, p, q, dn, d, half, receivers, twist, e):
    """Edge functions along d (3), their slack without the contribution of the lights (3), and with it (3).

    Vectors of any width, as in `verdict`.
    """
    # Eq. (5) of docs/design/multifrusta.md
    e2, e1 = dot(cp, d), -dot(cq, d)
    p_d, q_d = cross(p, d), cross(q, d)
    k2, g2 = _slack(cp, p_d, receivers, half, twist, e)
    k1, g1 = _slack(cq, q_d, receivers, half, twist, e)
    k0, g0 = _slack(add3(n, subtract3(cq, cp)), subtract3(q_d, p_d), receivers, half, twist + twist, e)
    return Vec3(dn - e1 - e2, e1, e2), Vec3(k0, k1, k2), Vec3(g0, g1, g2)


@kernel
def cull_block(tile, numbers, group, facing, work):
    """Bits of a block's triangles that segments of the shaft to a group may meet. Write their numbers to `work`."""
    info, shafts = tile.info, tile.shafts
    c = broadcasts(info, 0, 1)
    a, p, q = subtract3(rows(numbers, 0, 16), c), rows(numbers, 48, 16), rows(numbers, 96, 16)
    reach, size = largest(a), maximum(largest(p), largest(q))
    receivers = broadcasts(info, 3, 1)
    wide = maximum(reach, size) + (receivers.x + receivers.y + receivers.z)
    n, axis, span = cross(p, q), axis_of(shafts, group), get(shafts, SPAN + 1)
    floor = fma(wide, splat16(UNDERFLOW), splat16(UNDERFLOW * (span + _F(1.0))))
    te = fma(size * size * EDGE_UNIT, reach + span, floor)
    d, half = splats(axis.d), splats(axis.half)
    dn, t = dot(n, d), dot(a, n)
    f = t - dn
    kt = fma(abs_dot(n, receivers), splat16(MORE), te)
    gf = fma(abs_dot(n, half), splat16(MORE), te)
    same_side = (minimum(t - kt, f - gf) > _ZERO) | (maximum(t + kt, f + gf) < _ZERO)
    away = dn * _F(facing) > kt + gf
    culled = same_side | away | _outside(shafts, group, a, p, q, wide)
    remaining = bits(culled) ^ 0xFFFF
    if remaining == 0:
        return remaining
    cp, cq = cross(a, p), cross(a, q)
    e = fma(size * EDGE_UNIT, fma(wide, splat16(span), splat16(axis.lever)), floor)
    twist = size * (_F(2.0) * axis.twist)
    on, k, g = edges_along(cp, cq, n, p, q, dn, d, half, receivers, twist, e)
    some_up = maximum(maximum(on.x - g.x, on.y - g.y), on.z - g.z) > _ZERO
    some_down = minimum(minimum(on.x + g.x, on.y + g.y), on.z + g.z) < _ZERO
    remaining &= bits(some_up & some_down) ^ 0xFFFF
    if remaining != 0:
        store3(work, _CP, 16, cp)
        store3(work, _CQ, 16, cq)
        store3(work, _N, 16, n)
        store(work, _T, t)
        store3(work, _K, 16, k)
        store(work, _KT, kt)
        store(work, _KF, te)
        store(work, _E, e)
        store(work, _TE, te)
        store(work, _WIDE, wide)
        store(work, _SIZE, size)
    return remaining


@inlined
def _strata_beyond(shafts, at, a, p, q, wide):
    """mask16 of the strata whose shaft has a triangle, the same in all lanes, entirely beyond one plane."""
    w = rows(shafts, at + 16, N)
    nearest = dot(w, a) + minimum(minimum(dot(w, p), dot(w, q)), splat16(_ZERO))
    return nearest > fma(load16(shafts, at + 4 * N + 16), wide, load16(shafts, at + 3 * N + 16))


@inlined
def _strata_outside(tile, numbers, work, i):
    """mask16 of the strata whose shaft has triangle i entirely beyond one of its four planes."""
    shafts, wide = tile.shafts, broadcast16(work, _WIDE + i)
    a = subtract3(broadcasts(numbers, i, 16), broadcasts(tile.info, 0, 1))
    p, q = broadcasts(numbers, 48 + i, 16), broadcasts(numbers, 96 + i, 16)
    return (
        _strata_beyond(shafts, PLANES, a, p, q, wide)
        | _strata_beyond(shafts, PLANES + PLANE, a, p, q, wide)
        | _strata_beyond(shafts, PLANES + 2 * PLANE, a, p, q, wide)
        | _strata_beyond(shafts, PLANES + 3 * PLANE, a, p, q, wide)
    )


class Verdict(NamedTuple):
    """What is certain for 16 shafts and a triangle: bits of the lanes."""

    miss: int  # no segment meets the triangle
    cover: int  # all segments are blocked
    above: int  # all targets lie on the side of the triangle's plane that its normal points away from
    below: int  # all targets lie on the other side


@inlined
def verdict(e0, e1, e2, k0, k1, k2, t, kt, f, kf, facing):
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
    c0 = add3(n, subtract3(cq, cp))
    # Eq. (5) of docs/design/multifrusta.md
    dn, e2, e1 = dot(d, n), dot(d, cp), -dot(d, cq)
    e0 = dn - e1 - e2
    more = splat16(MORE)
    k0 = fma(abs_dot(c0, half), more, broadcast16(work, _K + i))
    k1 = fma(abs_dot(cq, half), more, broadcast16(work, _K + 16 + i))
    k2 = fma(abs_dot(cp, half), more, broadcast16(work, _K + 32 + i))
    kf = fma(abs_dot(n, half), more, broadcast16(work, _KF + i))
    t, kt = broadcast16(work, _T + i), broadcast16(work, _KT + i)
    v = verdict(e0, e1, e2, k0, k1, k2, t, kt, t - dn, kf, facing)
    return Verdict(v.miss | bits(_strata_outside(tile, numbers, work, i)), v.cover, v.above, v.below)


@inlined
def cull_beams(d, half, lanes, facing):
    """`Verdict` on beams along d with half extents `half` at the end: 16 beams and a triangle, or the reverse."""
    cp, qc, n, more = lanes.cp, lanes.qc, lanes.n, splat16(MORE)
    # Eq. (5) of docs/design/multifrusta.md
    dn, e2, e1 = dot(d, n), dot(d, cp), dot(d, qc)
    k0 = fma(abs_dot(subtract3(n, add3(qc, cp)), half), more, lanes.e)
    k1, k2 = fma(abs_dot(qc, half), more, lanes.e), fma(abs_dot(cp, half), more, lanes.e)
    kf = fma(abs_dot(n, half), more, lanes.te)
    return verdict(dn - e1 - e2, e1, e2, k0, k1, k2, lanes.t, lanes.te, lanes.t - dn, kf, facing)


@inlined
def cull_tiles(boxes, targets, numbers, work, i, facing):
    """`Verdict` on the shafts of 16 tiles and triangle i of a block, which `cull_block` has not culled for all tiles.

    boxes, targets : rows of centres (3) and half extents (3): boxes of receivers, and boxes of samples
    """
    o, receivers, half = rows(boxes, 0, 16), rows(boxes, 48, 16), rows(targets, 48, 16)
    d, a = subtract3(rows(targets, 0, 16), o), subtract3(broadcasts(numbers, i, 16), o)
    p, q, n = broadcasts(numbers, 48 + i, 16), broadcasts(numbers, 96 + i, 16), broadcasts(work, _N + i, 16)
    e, te = broadcast16(work, _E + i), broadcast16(work, _TE + i)
    twist = half.x * (receivers.y + receivers.z) + half.y * (receivers.x + receivers.z)
    twist = (twist + half.z * (receivers.x + receivers.y)) * (_F(2.0) * get(work, _SIZE + i))
    dn, t = dot(n, d), dot(a, n)
    on, _, g = edges_along(cross(a, p), cross(a, q), n, p, q, dn, d, half, receivers, twist, e)
    kt, kf = fma(abs_dot(n, receivers), splat16(MORE), te), fma(abs_dot(n, half), splat16(MORE), te)
    return verdict(on.x, on.y, on.z, g.x, g.y, g.z, t, kt, t - dn, kf, facing)


@inlined
def plane_of(work, i):
    """(distance of the receivers' centre from the plane of triangle i of the block, slack for all receivers)."""
    return get(work, _T + i), get(work, _KT + i)


@inlined
def triangle_size(work, i):
    """The largest component of the edges of triangle i of the block, in all lanes."""
    return broadcast16(work, _SIZE + i)


@inlined
def triangle_lanes(origins, numbers, work, i):
    """`Lanes` of triangle i of a block, which `cull_block` has not culled, for rays from 16 origins."""
    a = subtract3(broadcasts(numbers, i, 16), origins)
    p, q, n = broadcasts(numbers, 48 + i, 16), broadcasts(numbers, 96 + i, 16), broadcasts(work, _N + i, 16)
    return Lanes(cross(a, p), cross(q, a), n, dot(a, n), broadcast16(work, _E + i), broadcast16(work, _TE + i))


@inlined
def receiver_lanes(tile, numbers, r):
    """`Lanes` of the 16 triangles of a block for rays from receiver r."""
    return block_lanes(broadcasts(tile.origins, r, 16), numbers, broadcast16(tile.shafts, SPAN + 1))


@inlined
def block_lanes(origin, numbers, span):
    """`Lanes` of the 16 triangles of a block for rays from one origin, the same in all lanes.

    span : f32x16, at least the sum of the magnitudes of a direction's components
    """
    a, p, q = subtract3(rows(numbers, 0, 16), origin), rows(numbers, 48, 16), rows(numbers, 96, 16)
    n = cross(p, q)
    e, te = error_bounds(largest(a), maximum(largest(p), largest(q)), span)
    return Lanes(cross(a, p), cross(q, a), n, dot(a, n), e, te)


# --- A block against a tile -------------------------------------------------------------------------------------------


WORK = CULL_WORK + LANES  # float32 of scratch memory
_FEW_BEAMS = 6  # up to this many beams that meet a block are tested one by one
_FEW_STRATA = 8  # the same for strata
_FEW_RAYS = 4  # the same for rays of a stratum


@inlined
def _block_receivers(tile, receivers):
    """Mark all segments from `receivers` (bits) as blocked."""
    store(tile.dead, 0, load16(tile.dead, 0) | splat16(np.int32(receivers)))


@kernel
def on_light_side(tile, tree, slot, above, below, lanes):
    """Bits of the receivers in `lanes` that are surely on the light's side of a triangle's plane, in float64.

    Float32 cannot decide this for the surface on which the tile lies, or for triangles that continue this surface.

    above, below : bits of the receivers whose light is surely above, or surely below, the plane
    """
    f = np.float64
    a, n, error = plane(tree.corners, slot, f(0.0), f(0.0), f(0.0))
    settled = 0
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
        one = 1 << lane
        if (t > bound and above & one != 0) or (t < -bound and below & one != 0):
            settled |= one
    return settled


@inlined
def _test_samples(tile, b, slot, r, k, strata, counters):
    """Test the rays of receiver r against the triangle in lane k of the stored `Lanes`."""
    d = subtract3(rows(tile.by_lane, r * 48, 16), broadcasts(tile.origins, r, 16))
    count(counters, TRIANGLE_TESTS, 1)
    hit, unsure = decide(d, stored_lane(ptr_at(b.work, CULL_WORK), k), b.facing)
    dead, one = load16(tile.dead, 0), splat16(np.int32(1 << r))
    unsure &= strata
    if unsure != 0:
        defer(b.deferred, slot, tile.number << 8 | r, 16, unsure & bits((dead & one) == np.int32(0)))
    store(tile.dead, 0, with_blocked(dead, hit, one))


@kernel
def _test_strata(tile, b, slot, i, receivers, strata, counters):
    """Test rays between `receivers` and `strata` (bits) against triangle i, which `cull_block` has not culled."""
    lanes, dead = triangle_lanes(rows(tile.origins, 0, 16), numbers_of(b), b.work, i), load16(tile.dead, 0)
    while strata != 0:
        s = lowest_bit(strata)
        strata &= strata - 1
        d = subtract3(rows(tile.points, s * 48, 16), rows(tile.origins, 0, 16))
        count(counters, TRIANGLE_TESTS, 1)
        hit, unsure = decide(d, lanes, b.facing)
        unsure &= receivers & ~get(tile.dead, s)
        if unsure != 0:
            defer(b.deferred, slot, tile.number << 8 | s << 4, 1, unsure)
        dead = with_blocked(dead, 1 << s, splat16(np.int32(hit & receivers)))
    store(tile.dead, 0, dead)


@inlined
def _others(tile, b, slot):
    """Bits of the receivers that do not lie on the triangle in `slot`."""
    return b.valid & ~bits(load16(tile.faces, 0) == get(b.tree.prim_ids, slot))


@inlined
def _by_beams(tile, b, i, live, strata, counters):
    """Test triangle i, not culled by `cull_block`, against the beams in `live`. Return bits of those not covered."""
    d, half = beams_of(tile)
    slot, lanes = slot_of(b, i), triangle_lanes(rows(tile.origins, 0, 16), numbers_of(b), b.work, i)
    v = cull_beams(d, half, lanes, b.facing)
    receivers = live & ~v.miss & _others(tile, b, slot)
    on_plane = receivers & bits(absolute(lanes.t) <= lanes.te)
    if on_plane != 0:
        receivers &= ~on_light_side(tile, b.tree, slot, v.above, v.below, on_plane)
    covered = v.cover & receivers
    count(counters, COVERED, popcount(covered))
    _block_receivers(tile, covered)
    receivers &= ~covered
    if receivers != 0:
        store_lanes(ptr_at(b.work, CULL_WORK), lanes)
        while receivers != 0:
            r = lowest_bit(receivers)
            receivers &= receivers - 1
            _test_samples(tile, b, slot, r, r, strata, counters)
    return live & ~covered


@inlined
def _by_strata(tile, b, i, strata, counters):
    """Test triangle i, not culled by `cull_block`, against the shafts of `strata`. Return those with unblocked rays."""
    slot, v = slot_of(b, i), cull_strata(tile, numbers_of(b), b.work, i, b.facing)
    covered = v.cover & strata
    count(counters, COVERED, popcount(covered))
    if covered != 0:
        store(tile.dead, 0, with_blocked(load16(tile.dead, 0), covered, splat16(np.int32(-1))))
    strata &= ~covered
    tests, receivers = strata & ~v.miss, _others(tile, b, slot)
    t, slack = plane_of(b.work, i)
    if tests != 0 and abs(t) <= slack and (v.above == 0xFFFF or v.below == 0xFFFF):
        receivers &= ~on_light_side(tile, b.tree, slot, v.above, v.below, receivers)
    if tests != 0 and receivers != 0:
        _test_strata(tile, b, slot, i, receivers, tests, counters)
        strata &= ~finished_strata(tile, b.valid)
    return strata


@kernel
def _trace_receiver(tile, b, r, strata, counters):
    """Test the beam of receiver r against the triangles of a block, and its rays where the beam does not decide."""
    face, lanes, one = get(tile.faces, r), receiver_lanes(tile, numbers_of(b), r), 1 << r
    d, half = beam_of(tile, r)
    v = cull_beams(d, half, lanes, b.facing)
    triangles = b.present & ~v.miss
    count(counters, CANDIDATES, popcount(triangles))
    if triangles == 0:
        return
    cover, on_plane = v.cover & triangles, bits(absolute(lanes.t) <= lanes.te)
    while cover != 0:
        if get(b.tree.prim_ids, slot_of(b, lowest_bit(cover))) != face:
            count(counters, COVERED, 1)
            _block_receivers(tile, one)
            return
        cover &= cover - 1
    store_lanes(ptr_at(b.work, CULL_WORK), lanes)
    while triangles != 0:
        i = lowest_bit(triangles)
        slot = slot_of(b, i)
        triangles &= triangles - 1
        if get(b.tree.prim_ids, slot) != face:
            above, below = (v.above >> i & 1) << r, (v.below >> i & 1) << r
            if on_plane >> i & 1 == 0 or on_light_side(tile, b.tree, slot, above, below, one) == 0:
                _test_samples(tile, b, slot, r, i, strata, counters)


@inlined
def _trace_rays(tile, b, s, rays, counters):
    """Test rays of stratum s (bits) one by one against the triangles of a block. Return bits of the blocked rays."""
    blocked = 0
    while rays != 0:
        r = lowest_bit(rays)
        rays &= rays - 1
        o, place = broadcasts(tile.origins, r, 16), tile.number << 8 | s << 4 | r
        d = subtract3(broadcasts(tile.points, s * 48 + r, 16), o)
        if blocks_ray(b, o, d, get(tile.faces, r), place, counters):
            blocked |= 1 << r
    return blocked


@inlined
def _trace_row(tile, b, s, rays, triangles, counters):
    """Test rays of stratum s (bits) against triangles (bits), not culled by `cull_block`. Return the blocked rays."""
    d = subtract3(rows(tile.points, s * 48, 16), rows(tile.origins, 0, 16))
    open_rays = rays
    while triangles != 0 and open_rays != 0:
        i = lowest_bit(triangles)
        triangles &= triangles - 1
        slot = slot_of(b, i)
        count(counters, TRIANGLE_TESTS, 1)
        hit, unsure = decide(d, triangle_lanes(rows(tile.origins, 0, 16), numbers_of(b), b.work, i), b.facing)
        others = open_rays & _others(tile, b, slot)
        if unsure & others != 0:
            defer(b.deferred, slot, tile.number << 8 | s << 4, 1, unsure & others)
        open_rays &= ~(hit & others)
    return rays & ~open_rays


@kernel
def _trace_stratum(tile, b, s, box, counters):
    """Test the rays of stratum s against a block with its `Box`.

    A few rays are tested one by one. Otherwise the stratum's shaft culls triangles first.
    """
    rays = rays_in_box(tile, s, box) & b.valid & ~get(tile.dead, s)
    if popcount(rays) > _FEW_RAYS:
        triangles = cull_block(tile, numbers_of(b), 16 + s, b.facing, b.work) & b.present
        count(counters, CANDIDATES, popcount(triangles))
        rays = _trace_row(tile, b, s, rays, triangles, counters)
    else:
        rays = _trace_rays(tile, b, s, rays, counters)
    if rays != 0:
        store(tile.dead, 0, with_blocked(load16(tile.dead, 0), 1 << s, splat16(np.int32(rays))))


@kernel
def trace_block(tile, tree, number, triangles, strata, valid, facing, work, deferred, counters):
    """Test the segments from a tile to some strata against a block, and mark blocked segments in `tile.dead`.

    number, triangles : number of the block, and how many triangles it has
    strata, valid : bits of the strata, and of the tile's receivers
    """
    # In: tile, tree, number, triangles, strata, valid, facing. Out: work, deferred, counters, `tile.dead`.
    b = Block(tree, np.int64(number), (1 << triangles) - 1, valid, facing, work, deferred)
    count(counters, TRIANGLES, triangles)
    bounds = ptr_at(tree.bounds, bounds_at(b.number))
    box, use_beams = box_at(bounds), is_near(tile.shafts, tile.info, bounds)
    c, e = box.middle, box.half
    if use_beams:
        live, few = valid & ~np.int64(reduce_and(load16(tile.dead, 0))) & beams_in_box(tile, c, e), _FEW_BEAMS
    else:
        live, few = strata & strata_in_box(tile, c, e), _FEW_STRATA
    if popcount(live) <= few:
        while live != 0:
            k = lowest_bit(live)
            live &= live - 1
            if use_beams:
                _trace_receiver(tile, b, k, strata, counters)
            else:
                _trace_stratum(tile, b, k, box, counters)
        return
    remaining = cull_block(tile, numbers_of(b), group_of(strata), facing, work) & b.present
    count(counters, CANDIDATES, popcount(remaining))
    while remaining != 0 and live != 0:
        i = lowest_bit(remaining)
        remaining &= remaining - 1
        if use_beams:
            live = _by_beams(tile, b, i, live, strata, counters)
        else:
            live = _by_strata(tile, b, i, live, counters)
