"""Tests of a block against one stratum of a tile group, with tiles as lanes and rays compacted into full vectors.

Compaction. The rays that meet the block's box are gathered from all tiles into full vectors. If the light is large, a
single tile has few such rays, and a vector of its 16 receivers would be mostly empty.

Tests. A few rays are each tested against all triangles of the block. More rays are tested against the triangles that
the tile group's shaft may meet. If there are many rays, tiles that a single triangle covers completely are removed
first.
"""

from typing import NamedTuple

import numpy as np

from ...kernels.jit import F32Ptr, I32Ptr, inlined
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
    put,
    splat16,
    store,
    store_compressed,
)
from ...kernels.vec3 import Vec3, broadcasts, rows, subtract3
from ..counters import CANDIDATES, COVERED, TRIANGLE_TESTS, count
from ..light_table import STRATA
from ..shafts import HALF, REACH_FLOATS, D, N, rays_in_box, reach_of, shafts_in_box, store_reach, stored_reach
from ..tile import tile_at, with_blocked
from ..triangle_tests import blocks_ray, decide, defer, numbers_of, slot_of
from .shaft_culling import cull_block, cull_tiles, triangle_lanes

# --- Compaction of rays -----------------------------------------------------------------------------------------------


_ROW = 17 * 16  # the rays of 16 tiles, and one vector beyond them
COMPACTED_FLOATS = 8 * _ROW


class Compacted(NamedTuple):
    """Pointers to the rows of gathered rays in memory."""

    origins: F32Ptr  # float32, three rows
    points: F32Ptr  # float32, three rows: where the rays end
    places: I32Ptr  # int32, as for `triangle_tests.defer`
    faces: I32Ptr  # int32: their receivers' own triangles


@inlined
def compacted_at(memory):
    """The `Compacted` in COMPACTED_FLOATS float32."""
    return Compacted(
        memory, ptr_at(memory, 3 * _ROW), as_i32(ptr_at(memory, 6 * _ROW)), as_i32(ptr_at(memory, 7 * _ROW))
    )


@inlined
def gather(rays, n, tile, s, receivers):
    """Append the rays from a tile's `receivers` (bits) to stratum s to n gathered rays. Return the new count."""
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
    blocked = 0
    for r in range(n):
        o, place = broadcasts(rays.origins, r, _ROW), get(rays.places, r)
        d = subtract3(broadcasts(rays.points, r, _ROW), o)
        if blocks_ray(b, o, d, get(rays.faces, r), place, counters):
            blocked |= 1 << r
    return blocked


@inlined
def test_together(rays, first, n, b, triangles, counters):
    """Test at most 16 rays against triangles (bits) that `cull_block` has not culled. Return bits of the blocked rays.

    first, n : the first ray, and the number of rays
    """
    open_rays = (1 << n) - 1
    o, everyone = rows(rays.origins, first, _ROW), open_rays
    d, faces = subtract3(rows(rays.points, first, _ROW), o), load16(rays.faces, first)
    while triangles != 0 and open_rays != 0:
        i = lowest_bit(triangles)
        triangles &= triangles - 1
        slot = slot_of(b, i)
        lanes = triangle_lanes(o, numbers_of(b), b.work, i)
        count(counters, TRIANGLE_TESTS, 1)
        hit, unsure = decide(d, lanes, b.facing)
        others = open_rays & ~bits(faces == get(b.tree.prim_ids, slot))
        unsure &= others
        while unsure != 0:
            defer(b.deferred, slot, get(rays.places, first + lowest_bit(unsure)), 0, 1)
            unsure &= unsure - 1
        open_rays &= ~(hit & others)
    return everyone & ~open_rays


# --- A block against a stratum of a tile group ------------------------------------------------------------------------


BOXES = 6 * 16  # float32 of 16 boxes: rows of their centres (3) and half extents (3)
_FEW_RAYS = 6  # up to this many rays of all tiles are tested one by one
_MANY_RAYS = 48  # from this many rays on, triangles are first tested for covering entire tiles


@inlined
def _shafts_to(tile_group, s):
    """(origins, directions, half extents at the start, half extents at the end) of the tiles' shafts to stratum s."""
    o, t = rows(tile_group.boxes, 0, 16), ptr_at(tile_group.targets, s * BOXES)
    return o, subtract3(rows(t, 0, 16), o), rows(tile_group.boxes, 48, 16), rows(t, 48, 16)


@inlined
def store_reaches(tile_group):
    """Write the `Reach` of the tiles' shafts to each stratum, once the targets are filled."""
    for s in range(STRATA):
        o, v, start, end = _shafts_to(tile_group, s)
        store_reach(tile_group.reaches, s * REACH_FLOATS, reach_of(o, v, start, end))


@inlined
def tiles_in_box(tile_group, s, c, e):
    """Bits of the tiles whose shafts to stratum s may meet a box."""
    o, v, start, end = _shafts_to(tile_group, s)
    return shafts_in_box(o, v, start, end, stored_reach(tile_group.reaches, s * REACH_FLOATS), c, e)


@inlined
def tiles_near_box(tile_group, c, e):
    """Bits of the tiles whose shafts to the whole light may meet a box."""
    o, shafts = rows(tile_group.boxes, 0, 16), tile_group.union.shafts
    d, m = broadcasts(shafts, D + 1, N), broadcasts(tile_group.union.info, 0, 1)
    v = Vec3(d.x + (m.x - o.x), d.y + (m.y - o.y), d.z + (m.z - o.z))
    start, end = rows(tile_group.boxes, 48, 16), broadcasts(shafts, HALF + 1, N)
    return shafts_in_box(o, v, start, end, reach_of(o, v, start, end), c, e)


@inlined
def _blocked_rays(tile_group, dead, first, rays):
    """`dead` with gathered rays marked as blocked; rays: bits, counted from `first` on."""
    while rays != 0:
        place = get(tile_group.rays.places, first + lowest_bit(rays))
        rays &= rays - 1
        dead = with_blocked(dead, 1 << (place >> 8), splat16(np.int32(1 << (place & 15))))
    return dead


@inlined
def _tiles_with_rays(tile_group, s, live, chunk, box):
    """Bits of the tiles in `live` (bits) with unblocked rays to stratum s that meet a box; write the rays to `met`.

    No branch depends on a test, so that the tests overlap.
    """
    tiles = 0
    while live != 0:
        g = lowest_bit(live)
        live &= live - 1
        tile = tile_at(tile_group.tiles, g, chunk)
        rays = rays_in_box(tile, s, box) & ~get(tile_group.dead, 16 * s + g)
        put(tile_group.met, g, rays)
        tiles |= np.int64(rays != 0) << g
    return tiles


@inlined
def _gather_rays(tile_group, s, tiles, chunk):
    """Gather the rays in `met` of some tiles (bits). Return their number."""
    n = 0
    while tiles != 0:
        g = lowest_bit(tiles)
        tiles &= tiles - 1
        n = gather(tile_group.rays, n, tile_at(tile_group.tiles, g, chunk), s, get(tile_group.met, g))
    return n


@inlined
def _cover(tile_group, b, s, live, triangles, counters):
    """Test triangles (bits) against the shafts of tiles (bits) to stratum s.

    Return bits of the tiles that a single triangle covers completely.
    """
    all_covered, numbers, targets = 0, numbers_of(b), ptr_at(tile_group.targets, s * BOXES)
    while triangles != 0 and live != 0:
        covered = live & cull_tiles(tile_group.boxes, targets, numbers, b.work, lowest_bit(triangles), b.facing).cover
        triangles &= triangles - 1
        live &= ~covered
        all_covered |= covered
        count(counters, COVERED, popcount(covered))
    return all_covered


@inlined
def trace_tiles(tile_group, b, s, live, dead, chunk, box, counters):
    """Test a block against the segments from tiles in `live` (bits) to stratum s.

    dead : pointer to the stratum's row of `TileGroup.dead`, in which blocked segments are marked
    """
    tiles = _tiles_with_rays(tile_group, s, live, chunk, box)
    n = _gather_rays(tile_group, s, tiles, chunk)
    if n <= _FEW_RAYS:
        blocked = test_one_by_one(tile_group.rays, n, b, counters)
        store(dead, 0, _blocked_rays(tile_group, load16(dead, 0), 0, blocked))
        return
    row = load16(dead, 0)
    triangles = cull_block(tile_group.union, numbers_of(b), 16 + s, b.facing, b.work) & b.present
    count(counters, CANDIDATES, popcount(triangles))
    if n >= _MANY_RAYS:
        covered = _cover(tile_group, b, s, tiles, triangles, counters)
        if covered != 0:
            row = with_blocked(row, covered, splat16(np.int32(0xFFFF)))
            n = _gather_rays(tile_group, s, tiles & ~covered, chunk)
    for first in range(0, n, 16):
        blocked = test_together(tile_group.rays, first, min(n - first, 16), b, triangles, counters)
        row = _blocked_rays(tile_group, row, first, blocked)
    store(dead, 0, row)
