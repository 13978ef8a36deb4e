"""Reverse frusta: the rays of a tile group that share an end point on the light, with one receiver from each tile.

Adjacent tiles repeat the same 16 sample sets. So for a fixed light, the rays of a tile group end in 16 points per
stratum, up to 16 rays in each. A *fan* is the frustum of these rays with its origin on the light, the reverse of a
beam. It is narrow near the light, where the rays of a tile are far apart, and at the receivers no wider than the tile
group. All of its rays share an origin, so the edge functions of a triangle are set up once for the fan, and one test
culls triangles for all its rays.

At a block, lanes are the 16 fans of a stratum. If few of them meet the block's box, each fan is tested against the 16
triangles side by side, and then its rays. Otherwise the stratum's shaft culls triangles first, and each remaining
triangle is tested against the 16 fans side by side.

Rays are tested from the light to the receiver, so front and back faces are swapped.
"""

from typing import NamedTuple

import numpy as np

from ...kernels.jit import F32Ptr, I32Ptr, inlined, kernel
from ...kernels.simd import (
    as_i32,
    bits,
    broadcast16,
    get,
    load16,
    lowest_bit,
    popcount,
    ptr_at,
    put,
    reduce_and,
    splat16,
    store,
)
from ...kernels.vec3 import Vec3, broadcasts, cross, dot, largest, middles_and_halves, rows, store3, subtract3
from ..counters import CANDIDATES, COVERED, FAN_STRATA, TRIANGLE_TESTS, count
from ..light_table import POINTS, STRATA
from ..shafts import HALF, SPAN, D, N, reach_of, segments_in_box, shafts_in_box, store_inverses, widened
from ..tile import with_blocked
from ..triangle_tests import Lanes, decide, defer, error_bounds, numbers_of, slot_of, store_lanes, stored_lane
from .shaft_culling import CULL_WORK, block_lanes, cull_beams, cull_block, triangle_size

_F = np.float32
_FANS = STRATA * 16
_FACES, _BOXES = POINTS, POINTS + 256
_READY = _BOXES + 96
_REACH = _READY + 16
_INVERSES = _REACH + _FANS
FAN_FLOATS = _INVERSES + _FANS * 48
_FEW = 10  # up to this many fans that meet a block are tested one by one


class ReverseFrusta(NamedTuple):
    """Pointers to the fans of a tile group. Fan r has the receiver in lane r of each tile; lanes are tiles."""

    receivers: F32Ptr  # float32: rows x, y, z per fan
    faces: I32Ptr  # int32, one row per fan: the receivers' own triangles
    boxes: F32Ptr  # float32, rows of centres (3) and half extents (3), lanes are fans: boxes of the receivers
    ready: I32Ptr  # int32, one per stratum: bits of the fans whose reciprocals are filled
    reach: F32Ptr  # float32, 16 per stratum: R of the segments, see `shafts`
    inverses: F32Ptr  # float32, rows x, y, z per stratum and fan: reciprocals of the segments, see `shafts`


@inlined
def reverse_frusta_at(memory):
    """The `ReverseFrusta` in FAN_FLOATS float32."""
    return ReverseFrusta(
        memory,
        as_i32(ptr_at(memory, _FACES)),
        ptr_at(memory, _BOXES),
        as_i32(ptr_at(memory, _READY)),
        ptr_at(memory, _REACH),
        ptr_at(memory, _INVERSES),
    )


@inlined
def add_to_reverse_frusta(fans, lane, tile):
    """Make a tile a lane of the fans."""
    for r in range(16):
        for k in range(3):
            put(fans.receivers, 48 * r + 16 * k + lane, get(tile.origins, 16 * k + r))
        put(fans.faces, 16 * r + lane, get(tile.faces, r))


@inlined
def close_reverse_frusta(fans, low, high):
    """Finish the fans of the added tiles; low, high: corners of the boxes of receivers, lanes are fans."""
    middle, half = middles_and_halves(low, high)
    store3(fans.boxes, 0, 16, middle)
    store3(fans.boxes, 48, 16, half)
    store(fans.ready, 0, splat16(np.int32(0)))


@inlined
def _axes(fans, p):
    """(directions from points p to the centres of the receivers' boxes, half extents of the boxes); lanes are fans."""
    d, half = subtract3(rows(fans.boxes, 0, 16), p), rows(fans.boxes, 48, 16)
    return d, widened(d, half)


@inlined
def reverse_frusta_in_box(fans, points, box):
    """Bits of the fans of a stratum that may meet a `Box`; points: pointer to the stratum's points."""
    p, zero = rows(points, 0, 16), splat16(_F(0.0))
    d, half = _axes(fans, p)
    start = Vec3(zero, zero, zero)
    return shafts_in_box(p, d, start, half, reach_of(p, d, start, half), box.middle, box.half)


@inlined
def reverse_frusta_are_narrower(union, one, s, c):
    """True if fans are narrower than the tiles' shafts to stratum s at a point. Towards the light, fans narrow.

    union, one : the tile group as a `Tile`, and one of its tiles
    c : pointer to the point
    """
    along, square, light, more = _F(0.0), _F(0.0), _F(0.0), _F(0.0)
    for k in range(3):
        d = get(union.shafts, D + k * N + 16 + s)
        along += (get(c, k) - get(union.info, k)) * d
        square += d * d
        light += get(union.shafts, HALF + k * N + 16 + s)
        more += get(union.info, 3 + k) - get(one.info, 3 + k)
    return along * light > (square - along) * more


@inlined
def unblocked_rays(dead, r):
    """Bits of the tiles whose ray of fan r is not blocked; dead: pointer to the stratum's row of `TileGroup.dead`."""
    return bits((load16(dead, 0) & splat16(np.int32(1 << r))) == np.int32(0))


@inlined
def _block(dead, r, tiles):
    """Mark the rays of fan r from `tiles` (bits) as blocked."""
    store(dead, 0, with_blocked(load16(dead, 0), tiles, splat16(np.int32(1 << r))))


@inlined
def _others(fans, b, slot, r):
    """Bits of the tiles whose receiver r does not lie on the triangle in `slot`."""
    return bits(load16(fans.faces, 16 * r) != get(b.tree.prim_ids, slot))


@inlined
def _rays_in_box(fans, points, s, r, box):
    """Bits of the tiles whose ray of fan r to stratum s meets a `Box`."""
    o, fan = rows(fans.receivers, 48 * r, 16), 16 * s + r
    ready = get(fans.ready, s)
    if ready >> r & 1 == 0:
        put(fans.reach, fan, store_inverses(fans.inverses, 48 * fan, o, broadcasts(points, r, 16)))
        put(fans.ready, s, ready | 1 << r)
    return segments_in_box(o, rows(fans.inverses, 48 * fan, 16), broadcast16(fans.reach, fan), box)


@inlined
def _test_triangle(fans, b, points, s, r, dead, k, slot, counters):
    """Test the rays of fan r against the triangle in lane k of the stored `Lanes`."""
    d = subtract3(rows(fans.receivers, 48 * r, 16), broadcasts(points, r, 16))
    count(counters, TRIANGLE_TESTS, 1)
    hit, unsure = decide(d, stored_lane(ptr_at(b.work, CULL_WORK), k), -b.facing)
    others = _others(fans, b, slot, r)
    if unsure != 0:
        defer(b.deferred, slot, s << 4 | r, 256, unsure & others & unblocked_rays(dead, r))
    _block(dead, r, hit & others)


@inlined
def _test_ray(fans, b, points, s, r, g, lanes, counters):
    """True if a triangle of a block surely blocks the ray of fan r to tile g; lanes: triangles from the fan's point."""
    d = subtract3(broadcasts(fans.receivers, 48 * r + g, 16), broadcasts(points, r, 16))
    count(counters, TRIANGLE_TESTS, 1)
    hit, unsure = decide(d, lanes, -b.facing)
    hit, unsure, face = hit & b.present, unsure & b.present, get(fans.faces, 16 * r + g)
    while hit != 0:
        if get(b.tree.prim_ids, slot_of(b, lowest_bit(hit))) != face:
            return True
        hit &= hit - 1
    while unsure != 0:
        slot = slot_of(b, lowest_bit(unsure))
        unsure &= unsure - 1
        if get(b.tree.prim_ids, slot) != face:
            defer(b.deferred, slot, g << 8 | s << 4 | r, 0, 1)
    return False


@kernel
def _trace_fan(fans, union, b, points, s, r, dead, box, counters):
    """Test the rays of fan r against the triangles of a block."""
    rays = unblocked_rays(dead, r) & _rays_in_box(fans, points, s, r, box)
    if rays == 0:
        return
    point = broadcasts(points, r, 16)
    lanes = block_lanes(point, numbers_of(b), broadcast16(union.shafts, SPAN + 1))
    d = subtract3(broadcasts(fans.boxes, r, 16), point)
    v = cull_beams(d, widened(d, broadcasts(fans.boxes, 48 + r, 16)), lanes, -b.facing)
    triangles = b.present & ~v.miss
    count(counters, CANDIDATES, popcount(triangles))
    cover = v.cover & triangles
    while cover != 0:
        slot = slot_of(b, lowest_bit(cover))
        cover &= cover - 1
        count(counters, COVERED, 1)
        _block(dead, r, _others(fans, b, slot, r))
        rays &= unblocked_rays(dead, r)
    if popcount(triangles) <= popcount(rays):
        store_lanes(ptr_at(b.work, CULL_WORK), lanes)
        while triangles != 0:
            i = lowest_bit(triangles)
            triangles &= triangles - 1
            _test_triangle(fans, b, points, s, r, dead, i, slot_of(b, i), counters)
        return
    blocked = 0
    while rays != 0 and triangles != 0:
        g = lowest_bit(rays)
        rays &= rays - 1
        if _test_ray(fans, b, points, s, r, g, lanes, counters):
            blocked |= 1 << g
    _block(dead, r, blocked)


@inlined
def _by_fans(fans, union, b, points, s, live, dead, i, counters):
    """Test triangle i, which `cull_block` has not culled, against the fans in `live` (bits)."""
    point, numbers, slot = rows(points, 0, 16), numbers_of(b), slot_of(b, i)
    a, p, q = (
        subtract3(broadcasts(numbers, i, 16), point),
        broadcasts(numbers, 48 + i, 16),
        broadcasts(numbers, 96 + i, 16),
    )
    e, te = error_bounds(largest(a), triangle_size(b.work, i), broadcast16(union.shafts, SPAN + 1))
    n = cross(p, q)
    lanes = Lanes(cross(a, p), cross(q, a), n, dot(a, n), e, te)
    d, half = _axes(fans, point)
    v = cull_beams(d, half, lanes, -b.facing)
    covered, tests = live & v.cover, live & ~v.miss & ~v.cover
    count(counters, COVERED, popcount(covered))
    while covered != 0:
        r = lowest_bit(covered)
        covered &= covered - 1
        _block(dead, r, _others(fans, b, slot, r))
    if tests != 0:
        store_lanes(ptr_at(b.work, CULL_WORK), lanes)
        while tests != 0:
            r = lowest_bit(tests)
            tests &= tests - 1
            _test_triangle(fans, b, points, s, r, dead, r, slot, counters)


@kernel
def trace_reverse_frusta(fans, union, b, points, s, live, dead, box, counters):
    """Test the rays of fans in `live` (bits) of stratum s against a block, and mark blocked rays in `dead`.

    union : the tile group as a `Tile`
    points : pointer to the stratum's points
    dead : pointer to the stratum's row of `TileGroup.dead`
    box : `Box` of the block
    """
    count(counters, FAN_STRATA, 1)
    if popcount(live) <= _FEW:
        while live != 0:
            r = lowest_bit(live)
            live &= live - 1
            _trace_fan(fans, union, b, points, s, r, dead, box, counters)
        return
    triangles = cull_block(union, numbers_of(b), 16 + s, b.facing, b.work) & b.present
    count(counters, CANDIDATES, popcount(triangles))
    while triangles != 0 and live != 0:
        i = lowest_bit(triangles)
        triangles &= triangles - 1
        _by_fans(fans, union, b, points, s, live, dead, i, counters)
        live &= ~np.int64(reduce_and(load16(dead, 0)))
