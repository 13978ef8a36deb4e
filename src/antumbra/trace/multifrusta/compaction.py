"""Compaction: rays of a tile group to one stratum, gathered into full vectors.

Only rays that meet the box of a block are gathered. If the light is large, a single tile has few such rays. A vector of
its 16 receivers would be mostly empty.
"""

from typing import NamedTuple

import numpy as np

from ...kernels.fields import F32Ptr, I32Ptr
from ...kernels.jit import inlined
from ...kernels.simd import (
    as_i32,
    bits,
    get,
    iota16,
    load16,
    lowest_bit,
    mask_from_bits16,
    popcount,
    ptr_at,
    splat16,
    store_compressed,
)
from ...kernels.vec import broadcasts, minus, rows
from ..blocktest import blocks_ray, numbers_of, slot_of
from ..counters import TRIANGLE_TESTS, count
from ..deferred import defer
from ..raytest import decide
from .shaftcull import triangle_lanes

_ROW = 17 * 16  # room for the rays of 16 tiles, and for one vector beyond them
COMPACTED_FLOATS = 8 * _ROW


class Compacted(NamedTuple):
    """Pointers to the rows of gathered rays in memory."""

    origins: F32Ptr  # float32, three rows
    points: F32Ptr  # float32, three rows: where the rays end
    places: I32Ptr  # int32, as in `deferred`
    faces: I32Ptr  # int32: their receivers' own triangles


@inlined
def compacted_at(memory):
    """The `Compacted` in COMPACTED_FLOATS float32."""
    return Compacted(
        memory, ptr_at(memory, 3 * _ROW), as_i32(ptr_at(memory, 6 * _ROW)), as_i32(ptr_at(memory, 7 * _ROW))
    )


@inlined
def gather(rays, n, tile, s, receivers):
    """Append the rays from some receivers (bits) of a tile to stratum s to n gathered rays. Return the new count."""
    mask = mask_from_bits16(receivers)
    for k in range(3):
        store_compressed(rays.origins, k * _ROW + n, mask, load16(tile.origins, 16 * k))
        store_compressed(rays.points, k * _ROW + n, mask, load16(tile.points, s * 48 + 16 * k))
    store_compressed(rays.places, n, mask, iota16() + splat16(np.int32(tile.number << 8 | s << 4)))
    store_compressed(rays.faces, n, mask, load16(tile.faces, 0))
    return n + popcount(receivers)


@inlined
def test_one_by_one(rays, n, b, counters):
    """Test up to 64 rays, each against all triangles of a block. Return bits of the blocked rays."""
    blocked = np.int64(0)
    for r in range(n):
        o, place = broadcasts(rays.origins, r, _ROW), np.int64(get(rays.places, r))
        d = minus(broadcasts(rays.points, r, _ROW), o)
        if blocks_ray(b, o, d, get(rays.faces, r), place, counters):
            blocked |= np.int64(1) << r
    return blocked


@inlined
def test_together(rays, first, n, b, triangles, counters):
    """Test at most 16 rays against triangles (bits) that `cull_block` has kept. Return bits of the blocked rays.

    first, n : the first ray, and the number of rays
    """
    left = (np.int64(1) << n) - 1
    o, everyone = rows(rays.origins, first, _ROW), left
    d, faces = minus(rows(rays.points, first, _ROW), o), load16(rays.faces, first)
    while triangles != 0 and left != 0:
        i = lowest_bit(triangles)
        triangles &= triangles - 1
        slot = slot_of(b, i)
        lanes = triangle_lanes(o, numbers_of(b), b.work, i)
        count(counters, TRIANGLE_TESTS, 1)
        hit, unsure = decide(d, lanes, b.facing)
        others = left & ~bits(faces == get(b.tree.prim_ids, slot))
        unsure &= others
        while unsure != 0:
            defer(b.deferred, slot, np.int64(get(rays.places, first + lowest_bit(unsure))), 0, np.int64(1))
            unsure &= unsure - 1
        left &= ~(hit & others)
    return everyone & ~left
