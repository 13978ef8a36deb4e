"""Deferred tests: rays that float32 cannot decide, noted while tracing and settled later.

They are settled when their tile is done or their memory runs low. So the exact code stays out of the hot kernels. A ray
that another triangle blocks in the meantime needs no exact test.
"""

import numpy as np

from ..bvh.links import slot_at
from ..kernels.jit import inlined, kernel
from ..kernels.predicate.exact import segment
from ..kernels.simd import get, lowest_bit, ptr_at, put
from ..query.shadow_query import horizon_of, is_above
from .counters import UNCERTAIN, count
from .querychunk import place_of
from .rays.traverse import settle
from .tile import first_pixel, tile_at

DEFERRED = 16 * 16 * 16  # most tests that one block and one tile defer: triangles * strata * receivers


def deferred_ints(tiles):
    """int32 of memory for DEFERRED tests, and for all tests of one more block with `tiles` tiles.

    Layout: the count, an unused word, then slot and place of each test.
    """
    return 2 + 2 * (1 + tiles) * DEFERRED


@inlined
def defer(deferred, slot, place, step, unsure):
    """Note the triangle in `slot` for the `unsure` lanes (bits) of a row. Lane i is at ``place + i step``.

    A place is ``tile << 8 | stratum << 4 | receiver``. Slot -1 stands for the receiver's own surface: is the sample
    above it?
    """
    n = np.int64(get(deferred, 0))
    while unsure != 0:
        put(deferred, 2 + 2 * n, slot)
        put(deferred, 3 + 2 * n, place + lowest_bit(unsure) * step)
        unsure &= unsure - 1
        n += 1
    put(deferred, 0, n)


@inlined
def defer_triangles(deferred, tree, block, own, place, unsure):
    """Note the triangles of a block (bits) that may block the ray at `place`, except its receiver's `own` triangle."""
    while unsure != 0:
        slot = np.int64(get(tree.slots, slot_at(block, lowest_bit(unsure))))
        unsure &= unsure - 1
        if get(tree.prim_ids, slot) != own:
            defer(deferred, slot, place, 0, np.int64(1))


@kernel
def _is_blocked(corners, chunk, y0, x0, tile, slot, s, lane, counters):
    """Decide exactly whether the triangle in `slot`, or the receiver's own surface (slot -1), blocks a segment."""
    l = ptr_at(tile.points, s * 48 + lane)
    if slot < 0:
        count(counters, UNCERTAIN, 1)
        horizon = horizon_of(chunk.query, place_of(chunk, y0, x0, lane))
        return not is_above(horizon, get(l, 0), get(l, 16), get(l, 32), chunk.query.corners)
    o = ptr_at(tile.origins, lane)
    ray = segment(get(o, 0), get(o, 16), get(o, 32), get(l, 0), get(l, 16), get(l, 32))
    side = settle(ray, corners, slot, counters)
    return side != 0 and side != chunk.query.facing


@kernel
def settle_deferred(corners, chunk, tiles, pixels, deferred, counters):
    """Decide the deferred tests of some tiles exactly, and update the tiles' `dead`.

    tiles, pixels : as `tile.tile_at` and `tile.first_pixel` read them
    """
    for k in range(np.int64(get(deferred, 0))):
        slot, place = np.int64(get(deferred, 2 + 2 * k)), np.int64(get(deferred, 3 + 2 * k))
        g, s, lane = place >> 8, place >> 4 & 15, place & 15
        y0, x0 = first_pixel(pixels, g)
        tile = tile_at(tiles, g, chunk)
        dead = np.int64(get(tile.dead, s))
        if dead >> lane & 1 == 0 and _is_blocked(corners, chunk, y0, x0, tile, slot, s, lane, counters):
            put(tile.dead, s, dead | np.int64(1) << lane)
    put(deferred, 0, 0)
