"""A tile group: tiles near each other, traced as one towards a light that is large beside them.

In the walk, the lanes are the light's strata, as seen from the box around the receivers of all tiles. This box adds
little to the width of a stratum's shaft, and up to 16 tiles share the walk.

At a block, the lanes are the tiles, for each stratum whose shaft meets the block. The rays that meet the block's box
are gathered from these tiles into full vectors. Few rays are each tested against all triangles of the block. More rays
are tested against the triangles that the tile group's shaft may meet. If there are many rays, the tiles that one
triangle covers whole are removed first. Next to the receivers, `shaftleaf` tests blocks tile by tile, because beams are
narrower there.
"""

from typing import NamedTuple

import numpy as np

from ...bvh.nodes import middle_and_half
from ...kernels.fields import F32Ptr, I32Ptr
from ...kernels.jit import inlined, kernel
from ...kernels.simd import (
    as_i32,
    bits,
    get,
    load16,
    lowest_bit,
    mask_from_bits16,
    popcount,
    ptr_at,
    put,
    select,
    splat16,
    store,
)
from ...kernels.vec import Vec, broadcasts, minus, rows
from ..beams import is_near
from ..blocktest import Block, numbers_of
from ..counters import CANDIDATES, COVERED, TRIANGLES, count
from ..lighttable import ALL_GROUPS, STRATA
from ..segmentbox import box_at, rays_in_box
from ..shafts import HALF, D, N, make_shafts
from ..tile import Tile, finished_strata, tile_at
from .compaction import COMPACTED_FLOATS, Compacted, compacted_at, gather, test_one_by_one, test_together
from .shaftbox import shafts_in_box
from .shaftcull import cull_block, cull_tiles

_F = np.float32
_BOXES = 6 * 16  # float32 of 16 boxes: rows of their middles (3) and half extents (3)
_OPEN = (1 + STRATA) * _BOXES
TILE_GROUP_FLOATS = _OPEN + 16 + COMPACTED_FLOATS
_FEW_RAYS = 6  # up to this many rays of all tiles are tested one by one
_MANY_RAYS = 48  # from this many rays on, triangles that cover whole tiles are looked for first


class TileGroup(NamedTuple):
    """Pointers to a tile group's numbers in scratch memory. Its tiles are lanes."""

    tiles: F32Ptr  # float32, as `tile.tile_at` reads them
    valid: I32Ptr  # int32: bits of each tile's receivers
    whole: Tile  # all tiles as one: the box of their receivers, and its shafts
    boxes: F32Ptr  # float32: boxes of the tiles' receivers
    targets: F32Ptr  # float32: of each stratum, boxes of its samples for the tiles
    open: I32Ptr  # int32, one a stratum: bits of the tiles that have segments to it left
    rays: Compacted
    first: int  # number of one of its tiles


@inlined
def tile_group_at(memory, tiles, valid, whole, first):
    """The `TileGroup` in TILE_GROUP_FLOATS float32."""
    still_open, rays = as_i32(ptr_at(memory, _OPEN)), compacted_at(ptr_at(memory, _OPEN + 16))
    return TileGroup(tiles, valid, whole, memory, ptr_at(memory, _BOXES), still_open, rays, first)


@inlined
def tile_in(tile_group, g, chunk):
    """Tile g with the tile group's shafts, which contain the tile's own shafts."""
    t = tile_at(tile_group.tiles, g, chunk)
    return Tile(
        t.number, t.origins, tile_group.whole.info, t.faces, t.dead, tile_group.whole.shafts, t.beams, t.points,
        t.groups, t.targets, t.by_lane, t.inverses,
    )  # fmt: skip


@inlined
def _put_box(boxes, lane, k, low, high):
    """Write an interval of axis k to a lane of 16 boxes."""
    middle, half = middle_and_half(low, high)
    put(boxes, 16 * k + lane, middle)
    put(boxes, 48 + 16 * k + lane, half)


@inlined
def _widen(memory, low, high, by, by_low, by_high):
    """Widen the interval at words `low` and `high` of `memory` by the one at `by_low` and `by_high` of `by`."""
    put(memory, low, min(get(memory, low), get(by, by_low)))
    put(memory, high, max(get(memory, high), get(by, by_high)))


@inlined
def _add_tile(tile_group, tile, chunk):
    """Widen the tile group by the box of a tile's receivers. If the light moves with them, add its samples."""
    info, groups = tile_group.whole.info, tile_group.whole.groups
    for k in range(3):
        _widen(info, 6 + k, 9 + k, tile.info, 6 + k, 9 + k)
        _put_box(tile_group.boxes, tile.number, k, get(tile.info, 6 + k), get(tile.info, 9 + k))
    if not chunk.fixed:
        for k in range(3 * ALL_GROUPS):
            _widen(groups, k, 3 * ALL_GROUPS + k, tile.groups, k, 3 * ALL_GROUPS + k)
        for s in range(STRATA):
            for k in range(3):
                low = k * ALL_GROUPS + 16 + s
                boxes = ptr_at(tile_group.targets, s * _BOXES)
                _put_box(boxes, tile.number, k, get(tile.groups, low), get(tile.groups, low + 3 * ALL_GROUPS))


@inlined
def _aim_at_fixed(tile_group, chunk):
    """Fill the targets for a light that is the same for all tiles."""
    for s in range(STRATA):
        for k in range(3):
            low = k * ALL_GROUPS + 16 + s
            middle, half = middle_and_half(get(chunk.groups, low), get(chunk.groups, low + 3 * ALL_GROUPS))
            store(tile_group.targets, s * _BOXES + 16 * k, splat16(middle))
            store(tile_group.targets, s * _BOXES + 48 + 16 * k, splat16(half))


@inlined
def close(tile_group, g, strata):
    """Note that tile g has no segment left to some strata (bits)."""
    closed = select(mask_from_bits16(strata), splat16(np.int32(1 << g)), splat16(np.int32(0)))
    store(tile_group.open, 0, load16(tile_group.open, 0) & ~closed)


@kernel
def make_tile_group(tile_group, members, chunk):
    """Fill a tile group from the tiles in `members` (bits), which are ready to be traced."""
    info, groups = tile_group.whole.info, tile_group.whole.groups
    for k in range(3):
        put(info, 6 + k, _F(np.inf))
        put(info, 9 + k, _F(-np.inf))
    if chunk.fixed:
        _aim_at_fixed(tile_group, chunk)
    else:
        for k in range(3 * ALL_GROUPS):
            put(groups, k, _F(np.inf))
            put(groups, 3 * ALL_GROUPS + k, _F(-np.inf))
    store(tile_group.open, 0, splat16(np.int32(members)))
    while members != 0:
        g = lowest_bit(members)
        members &= members - 1
        tile = tile_at(tile_group.tiles, g, chunk)
        _add_tile(tile_group, tile, chunk)
        close(tile_group, g, finished_strata(tile, np.int64(get(tile_group.valid, g))))
    for k in range(3):
        middle, half = middle_and_half(get(info, 6 + k), get(info, 9 + k))
        put(info, k, middle)
        put(info, 3 + k, half)
    make_shafts(info, groups, tile_group.whole.shafts)


@inlined
def finished(tile_group):
    """Bits of the strata to which no segment is left."""
    return bits(load16(tile_group.open, 0) == splat16(np.int32(0)))


@inlined
def _tiles_in_box(tile_group, s, c, e):
    """Bits of the tiles whose shafts to stratum s may meet a box."""
    o, t = rows(tile_group.boxes, 0, 16), ptr_at(tile_group.targets, s * _BOXES)
    return shafts_in_box(o, minus(rows(t, 0, 16), o), rows(tile_group.boxes, 48, 16), rows(t, 48, 16), c, e)


@inlined
def _tiles_near_box(tile_group, c, e):
    """Bits of the tiles whose shafts to the whole light may meet a box."""
    o, shafts = rows(tile_group.boxes, 0, 16), tile_group.whole.shafts
    d, m = broadcasts(shafts, D + 1, N), broadcasts(tile_group.whole.info, 0, 1)
    v = Vec(d.x + (m.x - o.x), d.y + (m.y - o.y), d.z + (m.z - o.z))
    return shafts_in_box(o, v, rows(tile_group.boxes, 48, 16), broadcasts(shafts, HALF + 1, N), c, e)


@inlined
def _open_tiles(tile_group, strata):
    """Bits of the tiles that have a segment to any of some strata (bits) left."""
    tiles = np.int64(0)
    while strata != 0:
        tiles |= np.int64(get(tile_group.open, lowest_bit(strata)))
        strata &= strata - 1
    return tiles


@inlined
def _blocked(tile_group, g, s, receivers, chunk):
    """Note that the segments from some receivers (bits) of tile g to stratum s are blocked."""
    dead, valid = tile_at(tile_group.tiles, g, chunk).dead, np.int64(get(tile_group.valid, g))
    receivers |= np.int64(get(dead, s))
    put(dead, s, receivers)
    if receivers & valid == valid:
        put(tile_group.open, s, np.int64(get(tile_group.open, s)) & ~(np.int64(1) << g))


@inlined
def _blocked_rays(tile_group, s, first, rays, chunk):
    """Note that some gathered rays (bits, counted from the first on) are blocked."""
    while rays != 0:
        place = np.int64(get(tile_group.rays.places, first + lowest_bit(rays)))
        rays &= rays - 1
        _blocked(tile_group, place >> 8, s, np.int64(1) << (place & 15), chunk)


@inlined
def _rays_in_box(tile_group, s, live, chunk, box):
    """Gather the rays of some tiles (bits) to stratum s that meet a box and are not blocked. Return their number."""
    n = np.int64(0)
    while live != 0:
        g = lowest_bit(live)
        live &= live - 1
        tile = tile_at(tile_group.tiles, g, chunk)
        left = rays_in_box(tile, s, box) & np.int64(get(tile_group.valid, g)) & ~np.int64(get(tile.dead, s))
        if left != 0:
            n = gather(tile_group.rays, n, tile, s, left)
    return n


@inlined
def _cover(tile_group, b, s, live, left, chunk, counters):
    """Test triangles (bits) against the shafts of tiles (bits) to stratum s.

    Return bits of the tiles that no triangle covers whole.
    """
    numbers, targets = numbers_of(b), ptr_at(tile_group.targets, s * _BOXES)
    while left != 0 and live != 0:
        covered = live & cull_tiles(tile_group.boxes, targets, numbers, b.work, lowest_bit(left), b.facing).cover
        left &= left - 1
        live &= ~covered
        count(counters, COVERED, popcount(covered))
        while covered != 0:
            _blocked(tile_group, lowest_bit(covered), s, np.int64(0xFFFF), chunk)
            covered &= covered - 1
    return live


@inlined
def _trace_far(tile_group, b, s, live, chunk, box, counters):
    """Test a block against the segments from some tiles (bits) to stratum s."""
    n = _rays_in_box(tile_group, s, live, chunk, box)
    if n <= _FEW_RAYS:
        _blocked_rays(tile_group, s, np.int64(0), test_one_by_one(tile_group.rays, n, b, counters), chunk)
        return
    left = cull_block(tile_group.whole, numbers_of(b), 16 + s, b.facing, b.work) & b.present
    count(counters, CANDIDATES, popcount(left))
    if n >= _MANY_RAYS:
        not_covered = _cover(tile_group, b, s, live, left, chunk, counters)
        if not_covered != live:
            n = _rays_in_box(tile_group, s, not_covered, chunk, box)
    for first in range(0, n, 16):
        blocked = test_together(tile_group.rays, first, min(n - first, 16), b, left, counters)
        _blocked_rays(tile_group, s, first, blocked, chunk)


@inlined
def tiles_by_beams(tile_group, bounds, strata, chunk):
    """If a block is near the receivers, bits of the tiles to test it against one by one, else -1.

    bounds : pointer to the block's box
    """
    if not is_near(tile_group.whole.shafts, tile_at(tile_group.tiles, tile_group.first, chunk).info, bounds):
        return np.int64(-1)
    return _tiles_near_box(tile_group, broadcasts(bounds, 0, 1), broadcasts(bounds, 4, 1)) & _open_tiles(
        tile_group, strata
    )


@kernel
def trace_tile_group(tile_group, tree, number, triangles, strata, chunk, work, deferred, counters):
    """Test the segments of a tile group to some strata (bits) against a block. Blocked ones are noted in `dead`.

    number, triangles : of the block, and how many triangles it has
    """
    # In: tile_group, tree, number, triangles, strata, chunk. Out: work, deferred, counters, and the tiles' `dead`.
    b = Block(tree, np.int64(number), (np.int64(1) << triangles) - 1, np.int64(0), chunk.query.facing, work, deferred)
    box = box_at(ptr_at(tree.bounds, b.number * 8))
    count(counters, TRIANGLES, triangles)
    while strata != 0:
        s = lowest_bit(strata)
        strata &= strata - 1
        live = np.int64(get(tile_group.open, s)) & _tiles_in_box(tile_group, s, box.middle, box.half)
        if live != 0:
            _trace_far(tile_group, b, s, live, chunk, box, counters)
