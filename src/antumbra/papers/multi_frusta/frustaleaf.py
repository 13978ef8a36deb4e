"""A block of triangles against 16 frusta, one triangle at a time [Benthin and Wald 2009, Sec. 4.2, Fig. 2].

1. The triangle is tested against all frusta side by side. The test finds the sides of its plane that the receiver and
   the light are on. This culls back faces if only one side blocks.
2. The four corner rays are tested against its edges. The receiver's side of the plane gives the sign of a hit's edge
   functions. So one edge with all corner rays on the wrong side culls a frustum. If float32 cannot tell the side, two
   edges with opposite signs cull it.
3. The 16 rays of every remaining frustum are tested.
"""

from typing import NamedTuple

import numpy as np

from ...bvh.links import block_leaf, rows_at, slot_at
from ...kernels.jit import inlined, kernel
from ...kernels.simd import bits, fma, get, load16, lowest_bit, maximum, minimum, ptr_at, put, splat16
from ...kernels.vec import Vec, dot, largest, rows, scalars
from ...trace.counters import CANDIDATES, TRIANGLE_TESTS, TRIANGLES, count
from ...trace.packets.ray_tile import directions_of, open_rays
from ...trace.triangle_tests import LANES, decide, defer, keep_lanes, kept_lane, seen_from, triangle_along
from .cornerrays import CORNERS, OFF, SPAN

_F = np.float32
WORK = LANES  # float32 words of scratch memory


class Leaf(NamedTuple):
    """The frusta that a block changed."""

    done: int  # bits of the frusta that have no unblocked ray left
    struck: int  # bits of the frusta that lost a ray and have others left


@inlined
def _triangle(block, i):
    """Triangle i of a block, as a `raytest.Triangle`."""
    return triangle_along(scalars(block, i, 16), scalars(block, 48 + i, 16), scalars(block, 96 + i, 16))


@inlined
def _turned_away(lanes, facing):
    """Bits of the frusta whose receivers surely see the side of a triangle that does not block."""
    return bits(lanes.t * _F(facing) > lanes.te) if facing != 0 else np.int64(0)


@inlined
def _missed(frusta, lanes, triangle, wide):
    """mask16 of the frusta that certainly miss a triangle."""
    off, size, t, n = load16(frusta.own, OFF), triangle.size, lanes.t, lanes.n
    e = fma(off * wide, splat16(size * _F(18.1)), lanes.e)
    te = fma(off, splat16(size * size * _F(6.1)), lanes.te)
    far = splat16(_F(np.inf))
    low0, low1, low2, low_f, high0, high1, high2, high_f = far, far, far, far, -far, -far, -far, -far
    for corner in range(4):
        d = rows(frusta.own, CORNERS + 48 * corner, 16)
        e2, e1, dn = dot(d, lanes.cp), dot(d, lanes.qc), dot(d, n)
        e0, f = dn - e1 - e2, t - dn
        low0, low1, low2, low_f = minimum(low0, e0), minimum(low1, e1), minimum(low2, e2), minimum(low_f, f)
        high0, high1, high2, high_f = maximum(high0, e0), maximum(high1, e1), maximum(high2, e2), maximum(high_f, f)
    some_up = maximum(maximum(low0, low1), low2) > e
    some_down = minimum(minimum(high0, high1), high2) < -e
    above, below = t > lanes.te, t < -lanes.te
    return (above & (some_down | (low_f > te))) | (below & (some_up | (high_f < -te))) | (some_up & some_down)


@kernel
def _cull(tree, slot, block, i, mask, rays, frusta, facing, work):
    """Bits of the frusta in `mask` that may meet triangle i of a block. `work` gets the data for their ray tests."""
    own = bits(load16(rays.tile.faces, 0) == get(tree.prim_ids, slot))
    origins, triangle = rows(rays.tile.origins, 0, 16), _triangle(block, i)
    lanes = seen_from(origins, load16(frusta.own, SPAN), triangle)
    left = mask & ~own & ~_turned_away(lanes, facing)
    if left == 0:
        return left
    v = triangle.v
    a = Vec(v.x - origins.x, v.y - origins.y, v.z - origins.z)
    wide = maximum(largest(a), splat16(triangle.size))
    left &= ~bits(_missed(frusta, lanes, triangle, wide))
    if left != 0:
        keep_lanes(work, lanes)
    return left


@inlined
def _test_frustum(slot, rays, r, facing, work, deferred, counters):
    """Test the rays of frustum r against a triangle; return the bits of the rays that it blocks."""
    count(counters, TRIANGLE_TESTS, 1)
    hit, unsure = decide(directions_of(rays, r), kept_lane(work, r), facing)
    left = open_rays(rays, r)
    if unsure & left != 0:
        defer(deferred, slot, r * rays.row_place, rays.lane_place, unsure & left)
    return hit & left


@kernel
def trace_block(tree, link, mask, rays, frusta, facing, work, deferred, counters):
    """Test the frusta in `mask` against a block; return the `Leaf`. The lanes of `rays` are samples."""
    leaf, done, struck = block_leaf(link), np.int64(0), np.int64(0)
    block = ptr_at(tree.blocks, rows_at(leaf.block))
    for i in range(leaf.count):
        slot = np.int64(get(tree.slots, slot_at(leaf.block, i)))
        count(counters, TRIANGLES, 1)
        active = _cull(tree, slot, block, i, mask, rays, frusta, facing, work)
        if active == 0:
            continue
        count(counters, CANDIDATES, 1)
        while active != 0:
            r = lowest_bit(active)
            active &= active - 1
            hit = _test_frustum(slot, rays, r, facing, work, deferred, counters)
            if hit != 0:
                dead = np.int64(get(rays.dead, r)) | hit
                put(rays.dead, r, dead)
                struck |= np.int64(1) << r
                if dead & rays.lanes == rays.lanes:
                    done |= np.int64(1) << r
        mask &= ~done
        if mask == 0:
            break
    return Leaf(done, struck & ~done)
