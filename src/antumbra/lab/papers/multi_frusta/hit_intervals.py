"""The nearest hits of 16 primary rays so far, as intervals of t in float32, for packets and frusta.

A triangle replaces a hit if its interval is certainly nearer. Float64 and the contract's predicate decide the rest, and
compute the canonical t of the visible triangles at the end. The hits are therefore those of
`trace.primary.primary_rays.trace_primary`, bit for bit.
"""

from typing import NamedTuple

import numpy as np

from ....kernels.exact.filters import comes_first, meets
from ....kernels.jit import F32Ptr, F32x16, I32Ptr, inlined, kernel
from ....kernels.simd import (
    absolute,
    bits,
    get,
    load16,
    lowest_bit,
    mask_from_bits16,
    maximum,
    minimum,
    popcount,
    put,
    select,
    splat16,
    store,
)
from ....query.gbuffer import pixel_ray
from ....query.raster_setup import NO_PLANE, eye_plane, plane_t
from ....trace.counters import UNCERTAIN, count
from ....trace.triangle_tests import error_bounds

_F = np.float32
NOTHING = np.int32(-1)  # instead of a slot
_INFINITE, _LARGEST = _F(np.inf), _F(3e38)
_LESS, _MORE, _TINY = _F(1.0 - 2.0**-20), _F(1.0 + 2.0**-20), _F(1e-37)  # exceed all rounding of an interval


class PixelRow(NamedTuple):
    """The rays of 4 x 4 pixels and their nearest hits so far: pointers to rows of 16 lanes."""

    low: F32Ptr  # float32: lower bound of t; inf: no hit, -inf: no ray
    high: F32Ptr  # float32: upper bound of t
    slot: I32Ptr  # int32: the triangle's slot in the tree, or NOTHING
    x0: int  # first pixel
    y0: int


class LineTest(NamedTuple):
    """A triangle against the lines of 16 rays; f32x16. Eq. (7) of docs/design/exactness.md explains the numbers."""

    e1: F32x16  # two edge functions
    e2: F32x16
    dn: F32x16  # direction times normal
    t: F32x16  # distance of the origin from the plane, times the normal's length
    e: F32x16  # error bound of the edge functions
    te: F32x16  # error bound of t
    de: F32x16  # error bound of dn


@inlined
def pixel_of(row, lane):
    """(x, y) of the pixel of a lane."""
    return row.x0 + (lane & 3), row.y0 + (lane >> 2)


@inlined
def start_row(rays, row):
    """Reset a row to no hits. Return bits of the lanes inside the picture."""
    alive = np.int64(0)
    for lane in range(16):
        x, y = pixel_of(row, lane)
        alive |= np.int64(x < rays.width and y < rays.height) << lane
    far = select(mask_from_bits16(alive), splat16(_INFINITE), splat16(-_INFINITE))
    store(row.low, 0, far)
    store(row.high, 0, far)
    store(row.slot, 0, splat16(NOTHING))
    return alive


@inlined
def direction_bound(size, span):
    """`LineTest.de` of a triangle, without `off`; size, span: as in `error_bounds`."""
    return error_bounds(splat16(_F(0.0)), size, span)[
        1
    ]  # directions times a normal: as if the plane were at the origin


@inlined
def line_hits(test):
    """(bits of the rays whose lines certainly hit the triangle, bits of the rays that may hit it)."""
    e0 = test.dn - test.e1 - test.e2
    low, high = minimum(minimum(e0, test.e1), test.e2), maximum(maximum(e0, test.e1), test.e2)
    up, down, above, below = low > test.e, high < -test.e, test.t > test.te, test.t < -test.te
    missed = ((low < -test.e) & (high > test.e)) | (up & below) | (down & above)
    return bits((up & above) | (down & below)), bits(missed) ^ 0xFFFF


@inlined
def keep_hits(tree, slot, rays, row, test, mask, counters):
    """Record a triangle for the rays in `mask` (bits) whose nearest hit it is. Return whether there may be such rays.

    The aperture is tested first, then the distance [Benthin and Wald 2009, Sec. 4.2].
    """
    sure, maybe = line_hits(test)
    maybe &= mask
    if maybe == 0:
        return False
    candidates, wins = _keep_nearer(slot, row, test, sure, maybe)
    if candidates & ~wins != 0:
        count(counters, UNCERTAIN, popcount(candidates & ~wins))
        _settle(tree, slot, rays, row, sure, candidates & ~wins)
    return candidates != 0


@inlined
def _keep_nearer(slot, row, test, sure, maybe):
    """(bits of the rays that may have a nearer hit, those that certainly have one, which are recorded)."""
    t, size = absolute(test.t), absolute(test.dn)
    certain = size > test.de + test.de
    high = select(certain, (t + test.te) / (size - test.de), splat16(_INFINITE)) * _MORE + _TINY
    low = (t - test.te) / (size + test.de)
    low = low * select(low > _F(0.0), splat16(_LESS), splat16(_MORE)) - _TINY
    old_low, old_high = load16(row.low, 0), load16(row.high, 0)
    candidates = maybe & ~bits(low > old_high) & bits(old_high > -_INFINITE)
    wins = candidates & sure & bits(high < old_low)
    if wins != 0:
        there = mask_from_bits16(wins)
        store(row.low, 0, select(there, low, old_low))
        store(row.high, 0, select(there, high, old_high))
        store(row.slot, 0, select(there, splat16(np.int32(slot)), load16(row.slot, 0)))
    return candidates, wins


@kernel
def _settle(tree, slot, rays, row, sure, unsure):
    """`keep_hits` for the rays in `unsure` (bits), by the contract's own predicate and t."""
    plane, prim = eye_plane(tree.corners, slot, rays.origin), get(tree.prim_ids, slot)
    while unsure != 0:
        lane = lowest_bit(unsure)
        unsure &= unsure - 1
        x, y = pixel_of(row, lane)
        ray = pixel_ray(rays, x, y)
        if sure >> lane & 1 == 0 and meets(ray, tree.corners, slot) == 0:
            continue
        t, old = plane_t(plane, ray, tree.corners), get(row.slot, lane)
        if old != NOTHING:
            old_t = plane_t(eye_plane(tree.corners, old, rays.origin), ray, tree.corners)
            old_prim = get(tree.prim_ids, old)
            if not comes_first(ray, tree.corners, slot, prim, t, tree.corners, old, old_prim, old_t):
                continue
        low = _F(t) * _LESS - _TINY
        put(row.low, lane, low if low < _LARGEST else _LARGEST)
        put(row.high, lane, _F(t) * _MORE + _TINY)
        put(row.slot, lane, slot)


@kernel
def write_hits(tree, rays, row, alive, face, t):
    """Write the face and the float64 t of the rays in `alive` (bits) to the picture; face, t: its pointers."""
    plane = NO_PLANE
    while alive != 0:
        lane = lowest_bit(alive)
        alive &= alive - 1
        x, y = pixel_of(row, lane)
        at, slot = y * rays.width + x, get(row.slot, lane)
        if slot == NOTHING:
            put(face, at, NOTHING)
            put(t, at, np.inf)
            continue
        if slot != plane.triangle:
            plane = eye_plane(tree.corners, slot, rays.origin)
        put(face, at, get(tree.prim_ids, slot))
        put(t, at, plane_t(plane, pixel_ray(rays, x, y), tree.corners))
