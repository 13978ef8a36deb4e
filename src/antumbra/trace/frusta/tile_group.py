"""A tile group: neighbouring tiles traced as one towards a light that is large compared with their extent.

During traversal, lanes are the light's strata, as seen from the bounding box of all tiles' receivers. This box adds
little to the width of a stratum's shaft, and up to 16 tiles share the traversal.

A block is tested by the method with the narrowest frusta at its position:

- near the receivers, tile by tile with beams (`shaft_culling`),
- farther away, stratum by stratum with tiles as lanes (`tile_lanes`),
- near a fixed light, stratum by stratum with light points as lanes (`reverse_frusta`).
"""

from typing import NamedTuple

import numpy as np

from ...bvh.nodes import bounds_at, middle_and_half
from ...kernels.jit import F32Ptr, I32Ptr, inlined, kernel
from ...kernels.simd import (
    as_i32,
    bits,
    get,
    load16,
    lowest_bit,
    mask_from_bits16,
    maximum,
    minimum,
    popcount,
    ptr_at,
    put,
    reduce_and,
    select,
    splat16,
    stack_i32,
    store,
)
from ...kernels.vec3 import Vec3, broadcasts, rows
from ..counters import GROUP_STRATA, TRIANGLES, count
from ..light_table import ALL_GROUPS, STRATA
from ..shafts import REACH_FLOATS, box_at, is_near, make_shafts
from ..tile import Tile, finished_strata, tile_at
from ..triangle_tests import Block
from .reverse_frusta import (
    FAN_FLOATS,
    ReverseFrusta,
    add_to_reverse_frusta,
    close_reverse_frusta,
    reverse_frusta_are_narrower,
    reverse_frusta_at,
    reverse_frusta_in_box,
    trace_reverse_frusta,
)
from .tile_lanes import (
    BOXES,
    COMPACTED_FLOATS,
    Compacted,
    compacted_at,
    store_reaches,
    tiles_in_box,
    tiles_near_box,
    trace_tiles,
)

_F = np.float32
_MEMBERS, _FILLED, _STALE = 0, 1, 2  # words of `state`
_REACHES = (1 + STRATA) * BOXES
_OPEN = _REACHES + STRATA * REACH_FLOATS
_DEAD = _OPEN + 16
_STATE = _DEAD + 16 * STRATA
_MET = _STATE + 16
_FANS = _MET + 16
_COMPACTED = _FANS + FAN_FLOATS
TILE_GROUP_FLOATS = _COMPACTED + COMPACTED_FLOATS


class TileGroup(NamedTuple):
    """Pointers to a tile group's data in scratch memory; lanes are tiles."""

    tiles: F32Ptr  # float32, as `tile.tile_at` reads them
    valid: I32Ptr  # int32: bits of each tile's receivers
    union: Tile  # all tiles as one: the bounding box of their receivers, and its shafts
    boxes: F32Ptr  # float32: boxes of the tiles' receivers
    targets: F32Ptr  # float32: per stratum, boxes of its samples for the tiles
    reaches: F32Ptr  # float32: per stratum, a `shafts.Reach` of the tiles' shafts
    open: I32Ptr  # int32, one per stratum: bits of the tiles with unblocked segments to it
    dead: I32Ptr  # int32, 16 per stratum, one per tile: bits of the receivers whose segment is blocked
    state: I32Ptr  # int32: bits of its tiles, whether `dead`, `targets` and `fans` are filled, bits of stale tiles
    met: I32Ptr  # int32, one per tile: bits of its rays that meet a block, see `tile_lanes`
    fans: ReverseFrusta  # for a fixed light
    rays: Compacted
    first: int  # number of one of its tiles


@inlined
def tile_group_at(memory, tiles, valid, union, first):
    """The `TileGroup` in TILE_GROUP_FLOATS float32."""
    still_open, dead = as_i32(ptr_at(memory, _OPEN)), as_i32(ptr_at(memory, _DEAD))
    state, met = as_i32(ptr_at(memory, _STATE)), as_i32(ptr_at(memory, _MET))
    fans, rays = reverse_frusta_at(ptr_at(memory, _FANS)), compacted_at(ptr_at(memory, _COMPACTED))
    targets, reaches = ptr_at(memory, BOXES), ptr_at(memory, _REACHES)
    return TileGroup(
        tiles, valid, union, memory, targets, reaches, still_open, dead, state, met, fans, rays, first
    )  # fmt: skip


@inlined
def tile_in(tile_group, g, chunk):
    """Tile g with the tile group's shafts, which contain the tile's own shafts."""
    t = tile_at(tile_group.tiles, g, chunk)
    return Tile(
        t.number, t.origins, tile_group.union.info, t.faces, t.sides, t.dead, tile_group.union.shafts, t.beams,
        t.points, t.groups, t.targets, t.by_lane, t.inverses,
    )  # fmt: skip


@inlined
def _put_box(boxes, lane, k, low, high):
    """Write an interval of axis k to a lane of 16 boxes."""
    middle, half = middle_and_half(low, high)
    put(boxes, 16 * k + lane, middle)
    put(boxes, 48 + 16 * k + lane, half)


@inlined
def _widen(memory, low, high, by, by_low, by_high):
    """Extend the interval at words `low` and `high` of `memory` by the one at `by_low` and `by_high` of `by`."""
    put(memory, low, min(get(memory, low), get(by, by_low)))
    put(memory, high, max(get(memory, high), get(by, by_high)))


@inlined
def _add_tile(tile_group, tile, chunk):
    """Extend the tile group by the box of a tile's receivers and, if the light moves with them, by its samples."""
    info, groups = tile_group.union.info, tile_group.union.groups
    for k in range(3):
        _widen(info, 6 + k, 9 + k, tile.info, 6 + k, 9 + k)
        _put_box(tile_group.boxes, tile.number, k, get(tile.info, 6 + k), get(tile.info, 9 + k))
    if not chunk.fixed:
        for k in range(3 * ALL_GROUPS):
            _widen(groups, k, 3 * ALL_GROUPS + k, tile.groups, k, 3 * ALL_GROUPS + k)
        for s in range(STRATA):
            for k in range(3):
                low = k * ALL_GROUPS + 16 + s
                boxes = ptr_at(tile_group.targets, s * BOXES)
                _put_box(boxes, tile.number, k, get(tile.groups, low), get(tile.groups, low + 3 * ALL_GROUPS))


@inlined
def _set_fixed_targets(tile_group, chunk):
    """Fill the targets for a light that is the same for all tiles."""
    for s in range(STRATA):
        for k in range(3):
            low = k * ALL_GROUPS + 16 + s
            middle, half = middle_and_half(get(chunk.groups, low), get(chunk.groups, low + 3 * ALL_GROUPS))
            store(tile_group.targets, s * BOXES + 16 * k, splat16(middle))
            store(tile_group.targets, s * BOXES + 48 + 16 * k, splat16(half))


@inlined
def _dead_row(tile_group, s):
    """Pointer to the row of stratum s in `dead`."""
    return ptr_at(tile_group.dead, 16 * s)


@inlined
def _update_open(tile_group, s):
    """Update the bits of the tiles with unblocked segments to stratum s."""
    put(tile_group.open, s, bits(load16(_dead_row(tile_group, s), 0) != np.int32(-1)))


@inlined
def _record_blocked(tile_group, s, before):
    """Update `open` and the stale tiles if the row of stratum s has changed since `before`. Return whether it has."""
    tiles = bits(load16(_dead_row(tile_group, s), 0) != before)
    if tiles != 0:
        put(tile_group.state, _STALE, get(tile_group.state, _STALE) | tiles)
        _update_open(tile_group, s)
    return tiles != 0


@inlined
def copy_to_tile(tile_group, g, dead):
    """Copy the blocked segments of tile g from the group to the tile's `dead`, unless it is up to date."""
    stale = get(tile_group.state, _STALE)
    if stale >> g & 1 == 0:
        return
    put(tile_group.state, _STALE, stale & ~(1 << g))
    for s in range(STRATA):
        put(dead, s, get(dead, s) | get(tile_group.dead, 16 * s + g))


@kernel
def copy_to_tiles(tile_group, chunk):
    """Copy the blocked segments of all stale tiles from the group to the tiles."""
    stale = get(tile_group.state, _STALE)
    while stale != 0:
        g = lowest_bit(stale)
        stale &= stale - 1
        copy_to_tile(tile_group, g, tile_at(tile_group.tiles, g, chunk).dead)


@inlined
def _fill_fans(tile_group, members, chunk):
    """Fill the fans. Lanes without a tile repeat the first one."""
    first = tile_at(tile_group.tiles, tile_group.first, chunk)
    low = high = rows(first.origins, 0, 16)
    for g in range(16):
        tile = tile_at(tile_group.tiles, g if members >> g & 1 != 0 else tile_group.first, chunk)
        o = rows(tile.origins, 0, 16)
        low = Vec3(minimum(low.x, o.x), minimum(low.y, o.y), minimum(low.z, o.z))
        high = Vec3(maximum(high.x, o.x), maximum(high.y, o.y), maximum(high.z, o.z))
        add_to_reverse_frusta(tile_group.fans, np.int64(g), tile)
    close_reverse_frusta(tile_group.fans, low, high)


@inlined
def _close_strata(tile_group, g, strata):
    """Mark `strata` (bits) as completely blocked for tile g."""
    closed = select(mask_from_bits16(strata), splat16(np.int32(1 << g)), splat16(np.int32(0)))
    store(tile_group.open, 0, load16(tile_group.open, 0) & ~closed)


@kernel
def copy_from_tiles(tile_group, tiles, chunk):
    """Copy the blocked segments of `tiles` (bits) to the group."""
    while tiles != 0:
        g = lowest_bit(tiles)
        tiles &= tiles - 1
        absent, dead = ~get(tile_group.valid, g), tile_at(tile_group.tiles, g, chunk).dead
        for s in range(STRATA):
            put(tile_group.dead, 16 * s + g, get(dead, s) | absent)
    for s in range(STRATA):
        _update_open(tile_group, s)


@kernel
def make_tile_group(tile_group, members, chunk):
    """Make a tile group of the tiles in `members` (bits), which are prepared for tracing."""
    info, groups = tile_group.union.info, tile_group.union.groups
    put(tile_group.state, _MEMBERS, np.int32(members))
    put(tile_group.state, _FILLED, np.int32(0))
    put(tile_group.state, _STALE, np.int32(0))
    store(tile_group.open, 0, splat16(np.int32(members)))
    for k in range(3):
        put(info, 6 + k, _F(np.inf))
        put(info, 9 + k, _F(-np.inf))
    if not chunk.fixed:
        for k in range(3 * ALL_GROUPS):
            put(groups, k, _F(np.inf))
            put(groups, 3 * ALL_GROUPS + k, _F(-np.inf))
    while members != 0:
        g = lowest_bit(members)
        members &= members - 1
        tile = tile_at(tile_group.tiles, g, chunk)
        _add_tile(tile_group, tile, chunk)
        _close_strata(tile_group, g, finished_strata(tile, get(tile_group.valid, g)))
    for k in range(3):
        middle, half = middle_and_half(get(info, 6 + k), get(info, 9 + k))
        put(info, k, middle)
        put(info, 3 + k, half)
    make_shafts(info, groups, tile_group.union.shafts)


@kernel
def _fill(tile_group, chunk):
    """Fill the data for block tests. Deferred to the first block, because many groups meet none."""
    members = get(tile_group.state, _MEMBERS)
    put(tile_group.state, _FILLED, np.int32(1))
    if chunk.fixed:
        _set_fixed_targets(tile_group, chunk)
        _fill_fans(tile_group, members, chunk)
    store_reaches(tile_group)
    for s in range(STRATA):
        store(_dead_row(tile_group, s), 0, splat16(np.int32(-1)))
    copy_from_tiles(tile_group, members, chunk)


@inlined
def ensure_filled(tile_group, chunk):
    """Fill the data for block tests if this is the group's first block."""
    if get(tile_group.state, _FILLED) == 0:
        _fill(tile_group, chunk)


@inlined
def finished(tile_group):
    """Bits of the strata to which all segments are blocked."""
    return bits(load16(tile_group.open, 0) == splat16(np.int32(0)))


@inlined
def _open_tiles(tile_group, strata):
    """Bits of the tiles with an unblocked segment to any of `strata` (bits)."""
    tiles = 0
    while strata != 0:
        tiles |= get(tile_group.open, lowest_bit(strata))
        strata &= strata - 1
    return tiles


@inlined
def tiles_by_beams(tile_group, bounds, strata, chunk):
    """Bits of the tiles to test one by one against a block near the receivers; -1 if it is not near.

    bounds : pointer to the block's box
    """
    if not is_near(tile_group.union.shafts, tile_at(tile_group.tiles, tile_group.first, chunk).info, bounds):
        return -1
    tiles = tiles_near_box(tile_group, broadcasts(bounds, 0, 1), broadcasts(bounds, 4, 1))
    return tiles & _open_tiles(tile_group, strata)


@inlined
def _lanes_in_box(tile_group, s, by_fans, chunk, box):
    """Bits of the fans, or of the tiles, with unblocked segments to stratum s that may meet a `Box`."""
    if by_fans:
        alive = ~np.int64(reduce_and(load16(_dead_row(tile_group, s), 0)))
        return alive & reverse_frusta_in_box(tile_group.fans, ptr_at(chunk.points, 48 * s), box)
    return get(tile_group.open, s) & tiles_in_box(tile_group, s, box.middle, box.half)


@kernel
def trace_tile_group(tile_group, tree, number, triangles, strata, chunk, work, deferred, counters):
    """Test the segments of a tile group to `strata` (bits) against a block, and mark blocked segments in `dead`.

    Return whether any segment was marked.

    number, triangles : number of the block, and how many triangles it has
    """
    # In: tile_group, tree, number, triangles, strata, chunk. Out: work, deferred, counters, and the tiles' `dead`.
    b = Block(tree, np.int64(number), (1 << triangles) - 1, 0, chunk.query.facing, work, deferred)
    bounds = ptr_at(tree.bounds, bounds_at(b.number))
    box = box_at(bounds)
    count(counters, TRIANGLES, triangles)
    one = tile_at(tile_group.tiles, tile_group.first, chunk)
    by_fans = chunk.fixed and reverse_frusta_are_narrower(tile_group.union, one, lowest_bit(strata), bounds)
    lanes, remaining, blocks = stack_i32(STRATA), 0, False
    count(counters, GROUP_STRATA, popcount(strata))
    while strata != 0:
        s = lowest_bit(strata)
        strata &= strata - 1
        live = _lanes_in_box(tile_group, s, by_fans, chunk, box)
        put(lanes, s, live)
        remaining |= np.int64(live != 0) << s
    while remaining != 0:
        s = lowest_bit(remaining)
        remaining &= remaining - 1
        live, dead = get(lanes, s), _dead_row(tile_group, s)
        before = load16(dead, 0)
        if by_fans:
            points = ptr_at(chunk.points, 48 * s)
            trace_reverse_frusta(tile_group.fans, tile_group.union, b, points, s, live, dead, box, counters)
        else:
            trace_tiles(tile_group, b, s, live, dead, chunk, box, counters)
        blocks |= _record_blocked(tile_group, s, before)
    return blocks
