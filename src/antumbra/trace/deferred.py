"""Rays that float32 cannot decide: noted while tracing, settled when their tile is done or the memory runs low.

So the exact code stays out of the hot kernels, and a ray that something else blocks meanwhile is never settled.
"""

import numpy as np

from ..kernels.jit import inlined, kernel
from ..kernels.predicate.exact import segment
from ..kernels.simd import get, lowest_bit, ptr_at, put
from ..query.shadow import horizon_of, is_above
from .counters import UNCERTAIN, count
from .querychunk import place_of
from .rays.traverse import settle
from .tile import first_pixel, tile_at

ASIDE = 16 * 16 * 16  # rays that one block and tile put aside at most: triangles, strata, receivers


def aside_ints(tiles):
    """int32 of memory (how many, nothing, then slot and place of each) for ASIDE rays and all of one block more."""
    return 2 + 2 * (1 + tiles) * ASIDE


@inlined
def put_aside(aside, slot, place, step, unsure):
    """Note the triangle in `slot` for the `unsure` lanes (bits) of a row: lane i is at ``place + i step``.

    A place is ``tile << 8 | stratum << 4 | receiver``. Slot -1 asks whether the sample is above the receiver's surface.
    """
    n = np.int64(get(aside, 0))
    while unsure != 0:
        put(aside, 2 + 2 * n, slot)
        put(aside, 3 + 2 * n, place + lowest_bit(unsure) * step)
        unsure &= unsure - 1
        n += 1
    put(aside, 0, n)


@inlined
def put_triangles_aside(aside, tree, block, own, place, unsure):
    """Note the triangles of a block (bits) that may block the ray at `place`; its receiver's `own` cannot."""
    while unsure != 0:
        slot = np.int64(get(tree.slots, block * 16 + lowest_bit(unsure)))
        unsure &= unsure - 1
        if get(tree.prim_ids, slot) != own:
            put_aside(aside, slot, place, 0, np.int64(1))


@kernel
def _is_blocked(corners, asked, y0, x0, tile, slot, s, lane, counters):
    """Does the triangle in `slot`, or the receiver's own surface (slot -1), block a segment? Exact."""
    l = ptr_at(tile.points, s * 48 + lane)
    if slot < 0:
        count(counters, UNCERTAIN, 1)
        horizon = horizon_of(asked.query, place_of(asked, y0, x0, lane))
        return not is_above(horizon, get(l, 0), get(l, 16), get(l, 32), asked.query.corners)
    o = ptr_at(tile.origins, lane)
    ray = segment(get(o, 0), get(o, 16), get(o, 32), get(l, 0), get(l, 16), get(l, 32))
    side = settle(ray, corners, slot, counters)
    return side != 0 and side != asked.query.facing


@kernel
def settle_aside(corners, asked, tiles, pixels, aside, counters):
    """Decide exactly what was put aside about some tiles, and update their `dead`.

    tiles, pixels : as `tile.tile_at` and `tile.first_pixel` read them
    """
    for k in range(np.int64(get(aside, 0))):
        slot, place = np.int64(get(aside, 2 + 2 * k)), np.int64(get(aside, 3 + 2 * k))
        g, s, lane = place >> 8, place >> 4 & 15, place & 15
        y0, x0 = first_pixel(pixels, g)
        tile = tile_at(tiles, g, asked)
        dead = np.int64(get(tile.dead, s))
        if dead >> lane & 1 == 0 and _is_blocked(corners, asked, y0, x0, tile, slot, s, lane, counters):
            put(tile.dead, s, dead | np.int64(1) << lane)
    put(aside, 0, 0)
