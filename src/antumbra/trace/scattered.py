"""Samples that lie anywhere, such as interleaved point lights: packets of one receiver's rays through a tree of blocks.

Where the samples of a stratum are as far apart as those of the whole light, its shaft culls nothing, and neither does a
beam. Then multi-frusta tracing falls back to rays: the 16 lanes are a receiver's rays, and at a block each ray in turn
is tested against the triangles, side by side.
"""

import numpy as np

from ..bvh.blocks import ROWS
from ..jit import kernel
from ..scene.lights import LIST
from ..simd import get, lowest_bit, ptr_at
from .aside import put_triangles_aside
from .counters import TRIANGLE_TESTS, TRIANGLES, count
from .lighttable import STRATA
from .raytest import ray_meets
from .vec import broadcasts, minus

_WIDE = 0.1  # of a chunk's extents, those of a stratum from which on it is not worth a shaft


def is_scattered(query) -> bool:
    """Are the samples of a stratum points of a list, far apart? Those of one light are near each other."""
    if query.light.kind != LIST:
        return False
    low, high = query.samples.min(0), query.samples.max(0)  # (n, 3) of each stratum; samples of a list are points
    chunks = np.arange(0, len(low), STRATA)
    whole = np.maximum.reduceat(high, chunks) - np.minimum.reduceat(low, chunks)
    return bool((high - low).sum(1).mean() > _WIDE * whole.sum(1).mean())


@kernel
def trace_block(tree, rays, r, code, mask, facing, aside, counters):
    """Test the rays of row r, a receiver, that are in `mask` against a block; bits of those that it blocks."""
    block, present, hits = code >> 5, (np.int64(1) << (code & 31)) - 1, np.int64(0)
    numbers, o = ptr_at(tree.blocks, block * (ROWS * 16)), broadcasts(rays.origins, r * rays.stride, 16)
    while mask != 0:
        lane = lowest_bit(mask)
        mask &= mask - 1
        count(counters, TRIANGLES, code & 31)
        count(counters, TRIANGLE_TESTS, 1)
        hit, unsure = ray_meets(o, minus(broadcasts(rays.points, r * 48 + lane, 16), o), numbers, facing)
        if hit & present != 0:
            hits |= np.int64(1) << lane
        elif unsure & present != 0:
            place = r * rays.row_place + lane * rays.lane_place
            put_triangles_aside(aside, tree, block, get(rays.tile.faces, r), place, unsure & present)
    return hits
