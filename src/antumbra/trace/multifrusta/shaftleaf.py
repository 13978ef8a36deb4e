"""A block of triangles against a tile: cull and cover by shafts or beams, test rays only where neither decides.

Beams are narrower next to the receivers, and shafts of strata are narrower next to the light. `beams.is_near` chooses
between them for each block. The chosen 16 are first tested against the block's box.

- If few of them meet the box, each is tested against the 16 triangles side by side.
- Otherwise the triangles are culled side by side against one shaft. It leads to the smallest group that holds all live
  strata. Each triangle left is then tested against the 16 beams or strata side by side.

A pair that neither misses nor covers is tested ray by ray. One vector holds 16 samples of a receiver, or 16 receivers
and one stratum. If few rays of a stratum meet the block's box, each of them is tested against the 16 triangles.
"""

import numpy as np

from ...bvh.links import bounds_at
from ...kernels.jit import inlined, kernel
from ...kernels.predicate.filters import plane
from ...kernels.simd import (
    absolute,
    bits,
    get,
    load16,
    lowest_bit,
    popcount,
    ptr_at,
    reduce_and,
    splat16,
    store,
)
from ...kernels.vec import broadcasts, minus, rows
from ..beams import beam_of, beams_of, is_near
from ..blocktest import Block, blocks_ray, numbers_of, slot_of
from ..counters import CANDIDATES, COVERED, TRIANGLE_TESTS, TRIANGLES, count
from ..deferred import defer
from ..lighttable import group_of
from ..raytest import LANES, decide, keep_lanes, kept_lane
from ..segmentbox import box_at, rays_in_box
from ..tile import finished_strata, with_blocked
from .shaftbox import beams_in_box, strata_in_box
from .shaftcull import CULL_WORK, cull_beams, cull_block, cull_strata, plane_of, receiver_lanes, triangle_lanes

WORK = CULL_WORK + LANES  # float32 of scratch memory
_FEW_BEAMS = 6  # up to this many beams that meet a block are tested one by one
_FEW_STRATA = 8  # the same for strata
_FEW_RAYS = 4  # the same for rays of a stratum


@inlined
def _block_receivers(tile, receivers):
    """Note that all segments from some receivers (bits) are blocked."""
    store(tile.dead, 0, load16(tile.dead, 0) | splat16(np.int32(receivers)))


@kernel
def on_the_lights_side(tile, tree, slot, above, below, lanes):
    """Bits of the receivers in `lanes` that are surely on the light's side of a triangle's plane, in float64.

    Float32 cannot decide this for the surface that the tile lies on, or for triangles that continue this surface.

    above, below : bits of the receivers whose light is surely above, or surely below, the plane
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
        one = np.int64(1) << lane
        if (t > bound and above & one != 0) or (t < -bound and below & one != 0):
            settled |= one
    return settled


@inlined
def _test_samples(tile, b, slot, r, k, strata, counters):
    """Test the rays of receiver r against the triangle in lane k of the kept `Lanes`."""
    d = minus(rows(tile.by_lane, r * 48, 16), broadcasts(tile.origins, r, 16))
    count(counters, TRIANGLE_TESTS, 1)
    hit, unsure = decide(d, kept_lane(ptr_at(b.work, CULL_WORK), k), b.facing)
    dead, one = load16(tile.dead, 0), splat16(np.int32(1 << r))
    unsure &= strata
    if unsure != 0:
        defer(b.deferred, slot, tile.number << 8 | r, 16, unsure & bits((dead & one) == np.int32(0)))
    store(tile.dead, 0, with_blocked(dead, hit, one))


@kernel
def _test_strata(tile, b, slot, i, receivers, strata, counters):
    """Test the rays from some receivers to some strata (bits) against triangle i, which `cull_block` has kept."""
    lanes, dead = triangle_lanes(rows(tile.origins, 0, 16), numbers_of(b), b.work, i), load16(tile.dead, 0)
    while strata != 0:
        s = lowest_bit(strata)
        strata &= strata - 1
        d = minus(rows(tile.points, s * 48, 16), rows(tile.origins, 0, 16))
        count(counters, TRIANGLE_TESTS, 1)
        hit, unsure = decide(d, lanes, b.facing)
        unsure &= receivers & ~np.int64(get(tile.dead, s))
        if unsure != 0:
            defer(b.deferred, slot, tile.number << 8 | s << 4, 1, unsure)
        dead = with_blocked(dead, np.int64(1) << s, splat16(np.int32(hit & receivers)))
    store(tile.dead, 0, dead)


@inlined
def _others(tile, b, slot):
    """Bits of the receivers that do not lie on the triangle in `slot`."""
    return b.valid & ~bits(load16(tile.faces, 0) == get(b.tree.prim_ids, slot))


@inlined
def _by_beams(tile, b, i, live, strata, counters):
    """Test triangle i, which `cull_block` has kept, against the beams in `live`. Return bits of those not covered."""
    d, half = beams_of(tile)
    slot, lanes = slot_of(b, i), triangle_lanes(rows(tile.origins, 0, 16), numbers_of(b), b.work, i)
    v = cull_beams(d, half, lanes, b.facing)
    receivers = live & ~v.miss & _others(tile, b, slot)
    on_plane = receivers & bits(absolute(lanes.t) <= lanes.te)
    if on_plane != 0:
        receivers &= ~on_the_lights_side(tile, b.tree, slot, v.above, v.below, on_plane)
    covered = v.cover & receivers
    count(counters, COVERED, popcount(covered))
    _block_receivers(tile, covered)
    receivers &= ~covered
    if receivers != 0:
        keep_lanes(ptr_at(b.work, CULL_WORK), lanes)
        while receivers != 0:
            r = lowest_bit(receivers)
            receivers &= receivers - 1
            _test_samples(tile, b, slot, r, r, strata, counters)
    return live & ~covered


@inlined
def _by_strata(tile, b, i, strata, counters):
    """Test triangle i, which `cull_block` has kept, against the shafts of some strata. Return those with rays left."""
    slot, v = slot_of(b, i), cull_strata(tile, numbers_of(b), b.work, i, b.facing)
    covered = v.cover & strata
    count(counters, COVERED, popcount(covered))
    if covered != 0:
        store(tile.dead, 0, with_blocked(load16(tile.dead, 0), covered, splat16(np.int32(-1))))
    strata &= ~covered
    tests, receivers = strata & ~v.miss, _others(tile, b, slot)
    t, slack = plane_of(b.work, i)
    if tests != 0 and abs(t) <= slack and (v.above == 0xFFFF or v.below == 0xFFFF):
        receivers &= ~on_the_lights_side(tile, b.tree, slot, v.above, v.below, receivers)
    if tests != 0 and receivers != 0:
        _test_strata(tile, b, slot, i, receivers, tests, counters)
        strata &= ~finished_strata(tile, b.valid)
    return strata


@kernel
def _trace_receiver(tile, b, r, strata, counters):
    """Test the beam of receiver r against the triangles of a block. Where the beam does not decide, test its rays."""
    own, lanes, one = get(tile.faces, r), receiver_lanes(tile, numbers_of(b), r), np.int64(1) << r
    d, half = beam_of(tile, r)
    v = cull_beams(d, half, lanes, b.facing)
    left = b.present & ~v.miss
    count(counters, CANDIDATES, popcount(left))
    if left == 0:
        return
    cover, on_plane = v.cover & left, bits(absolute(lanes.t) <= lanes.te)
    while cover != 0:
        if get(b.tree.prim_ids, slot_of(b, lowest_bit(cover))) != own:
            count(counters, COVERED, 1)
            _block_receivers(tile, one)
            return
        cover &= cover - 1
    keep_lanes(ptr_at(b.work, CULL_WORK), lanes)
    while left != 0:
        i = lowest_bit(left)
        slot = slot_of(b, i)
        left &= left - 1
        if get(b.tree.prim_ids, slot) != own:
            above, below = (v.above >> i & 1) << r, (v.below >> i & 1) << r
            if on_plane >> i & 1 == 0 or on_the_lights_side(tile, b.tree, slot, above, below, one) == 0:
                _test_samples(tile, b, slot, r, i, strata, counters)


@inlined
def _trace_rays(tile, b, s, rays, counters):
    """Test rays of stratum s (bits) one by one against the triangles of a block. Return bits of the blocked rays."""
    blocked = np.int64(0)
    while rays != 0:
        r = lowest_bit(rays)
        rays &= rays - 1
        o, place = broadcasts(tile.origins, r, 16), tile.number << 8 | s << 4 | r
        d = minus(broadcasts(tile.points, s * 48 + r, 16), o)
        if blocks_ray(b, o, d, get(tile.faces, r), place, counters):
            blocked |= np.int64(1) << r
    return blocked


@inlined
def _trace_row(tile, b, s, rays, triangles, counters):
    """Test rays of stratum s (bits) against triangles (bits) that `cull_block` has kept. Return the blocked rays."""
    d = minus(rows(tile.points, s * 48, 16), rows(tile.origins, 0, 16))
    left = rays
    while triangles != 0 and left != 0:
        i = lowest_bit(triangles)
        triangles &= triangles - 1
        slot = slot_of(b, i)
        count(counters, TRIANGLE_TESTS, 1)
        hit, unsure = decide(d, triangle_lanes(rows(tile.origins, 0, 16), numbers_of(b), b.work, i), b.facing)
        others = left & _others(tile, b, slot)
        if unsure & others != 0:
            defer(b.deferred, slot, tile.number << 8 | s << 4, 1, unsure & others)
        left &= ~(hit & others)
    return rays & ~left


@kernel
def _trace_stratum(tile, b, s, box, counters):
    """Test the rays of stratum s against a block with its `Box`.

    Few rays are tested one by one. Otherwise the stratum's shaft culls triangles first.
    """
    rays = rays_in_box(tile, s, box) & b.valid & ~np.int64(get(tile.dead, s))
    if popcount(rays) > _FEW_RAYS:
        left = cull_block(tile, numbers_of(b), 16 + s, b.facing, b.work) & b.present
        count(counters, CANDIDATES, popcount(left))
        rays = _trace_row(tile, b, s, rays, left, counters)
    else:
        rays = _trace_rays(tile, b, s, rays, counters)
    if rays != 0:
        store(tile.dead, 0, with_blocked(load16(tile.dead, 0), np.int64(1) << s, splat16(np.int32(rays))))


@kernel
def trace_block(tile, tree, number, triangles, strata, valid, facing, work, deferred, counters):
    """Test the segments from a tile to some strata against a block. Blocked ones are noted in `tile.dead`.

    number, triangles : of the block, and how many triangles it has
    strata, valid : bits of the strata, and of the tile's receivers
    """
    # In: tile, tree, number, triangles, strata, valid, facing. Out: work, deferred, counters, `tile.dead`.
    b = Block(tree, np.int64(number), (np.int64(1) << triangles) - 1, valid, facing, work, deferred)
    count(counters, TRIANGLES, triangles)
    bounds = ptr_at(tree.bounds, bounds_at(b.number))
    box, near = box_at(bounds), is_near(tile.shafts, tile.info, bounds)
    c, e = box.middle, box.half
    if near:
        live, few = valid & ~np.int64(reduce_and(load16(tile.dead, 0))) & beams_in_box(tile, c, e), _FEW_BEAMS
    else:
        live, few = strata & strata_in_box(tile, c, e), _FEW_STRATA
    if popcount(live) <= few:
        while live != 0:
            k = lowest_bit(live)
            live &= live - 1
            if near:
                _trace_receiver(tile, b, k, strata, counters)
            else:
                _trace_stratum(tile, b, k, box, counters)
        return
    left = cull_block(tile, numbers_of(b), group_of(strata), facing, work) & b.present
    count(counters, CANDIDATES, popcount(left))
    while left != 0 and live != 0:
        i = lowest_bit(left)
        left &= left - 1
        if near:
            live = _by_beams(tile, b, i, live, strata, counters)
        else:
            live = _by_strata(tile, b, i, live, counters)
