"""Segments that float32 cannot decide: noted while tracing, settled when a bundle of them is done.

So the exact code stays out of the hot kernels, and a segment that something else blocks meanwhile is never settled.
"""

import numpy as np

from ..jit import inlined, kernel
from ..predicate.exact import segment
from ..simd import get, lowest_bit, put
from .tile import tile_at
from .traverse import settle

ASIDE = 2 * 4096  # segments that can be put aside; one block and tile need at most 4096
ASIDE_INTS = 2 + 2 * ASIDE  # int32 of memory: how many, nothing, then slot and place of each


@inlined
def put_aside(aside, slot, place, step, unsure):
    """Note the triangle in `slot` for the `unsure` lanes (bits): lane i is at ``place + i step``.

    A place is ``tile << 8 | stratum << 4 | receiver``.
    """
    n = np.int64(get(aside, 0))
    while unsure != 0:
        put(aside, 2 + 2 * n, slot)
        put(aside, 3 + 2 * n, place + lowest_bit(unsure) * step)
        unsure &= unsure - 1
        n += 1
    put(aside, 0, n)


@kernel
def settle_aside(corners, tiles, finished, table, chunk, fixed, facing, aside, counters):
    """Decide exactly what was put aside; `finished`: bits of each tile's strata that have no segment left."""
    for k in range(np.int64(get(aside, 0))):
        slot, code = np.int64(get(aside, 2 + 2 * k)), np.int64(get(aside, 3 + 2 * k))
        g, s, lane = code >> 8, code >> 4 & 15, code & 15
        tile = tile_at(tiles, g, table, chunk, fixed)
        dead = np.int64(get(tile.dead, s))
        if (dead >> lane | np.int64(get(finished, g)) >> s) & 1 == 0:
            o, l = lane, s * 48 + lane
            ray = segment(
                get(tile.origins, o), get(tile.origins, o + 16), get(tile.origins, o + 32),
                get(tile.points, l), get(tile.points, l + 16), get(tile.points, l + 32),
            )  # fmt: skip
            side = settle(ray, corners, slot, counters)
            if side != 0 and side != facing:
                put(tile.dead, s, dead | np.int64(1) << lane)
    put(aside, 0, 0)
