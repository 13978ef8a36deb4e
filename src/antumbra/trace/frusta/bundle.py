"""Bundles: up to 16 tiles whose shafts traverse the trees of a tree list together, and their block tests.

The 16 lanes of a bundle are groups of strata of its tiles, or the strata of a tile group. Each thread has scratch
memory for one bundle. The box of a block is prefetched when the traversal reaches it, and the block is tested when it
reaches the next one. Blocks that recently blocked all segments of a lane are tested first.
"""

from typing import NamedTuple

import numpy as np

from ...bvh.nodes import MAX_DEPTH, block_leaf, bounds_at, is_leaf
from ...kernels.jit import F32Ptr, I32Ptr, inlined, kernel, overload
from ...kernels.simd import bits, get, load16, lowest_bit, prefetch, ptr_at, put
from ..descent import Shafts, after_leaf, next_leaf, not_started, save, slabs_of
from ..light_table import ALL_GROUPS, STRATA
from ..shafts import ensure_shafts
from ..tile import TILE_FLOATS, QueryChunk, finished_strata, tile_at
from ..tree_list import TREE, list_of, tree_in, walk_tree, walk_tree_list
from ..triangle_tests import DEFERRED, deferred_ints, resolve_deferred
from .shaft_culling import trace_block
from .tile_clusters import MAX_TILES
from .tile_group import (
    copy_from_tiles,
    copy_to_tile,
    copy_to_tiles,
    ensure_filled,
    finished,
    tile_group_at,
    tile_in,
    tiles_by_beams,
    trace_tile_group,
)

# --- A bundle and its scratch memory ----------------------------------------------------------------------------------


TILES = (MAX_TILES + 1) * TILE_FLOATS  # the last one is the union of a tile group
LANES = 12 * 16
STACK = 4 * MAX_DEPTH
PLACES = 2 * MAX_TILES
WAITING = TREE + 1  # a leaf and its lanes, to be tested next
BLOCKERS = WAITING + 2  # a tree's number, then blocks that blocked all segments of a lane, most recent first
N_BLOCKERS = 4
TRIED = BLOCKERS + 1 + N_BLOCKERS  # how many of these blocks have been tested, or are in WAITING, in this traversal
AT = TRIED + 1
DEFERRED_INTS = deferred_ints(MAX_TILES)


class Bundle(NamedTuple):
    """How the 16 lanes of a bundle share its tiles and strata."""

    tiles: int  # 1 to 16, a power of two; a tile group counts as one tile
    groups: int  # groups of strata per tile: lanes are slot * groups + group
    strata: int  # strata per group
    is_tile_group: bool


class Scratch(NamedTuple):
    """A thread's memory."""

    tiles: F32Ptr  # float32: the parts of a cluster
    lanes: F32Ptr  # float32, rows of `Shafts`
    work: F32Ptr  # float32, for `shaft_culling`
    tile_group: F32Ptr  # float32, see `tile_group`
    stack: I32Ptr  # int32: links and masks
    slots: I32Ptr  # int32: the bundle's tiles
    valid: I32Ptr  # int32: bits of each tile's receivers
    parts: I32Ptr  # int32, see `tile_clusters.TileParts`
    places: I32Ptr  # int32: y and x of each tile's first pixel
    at: I32Ptr  # int32: a traversal saved by `descent.save`, then the data at TREE, WAITING, BLOCKERS and TRIED
    deferred: I32Ptr  # int32, see `triangle_tests.deferred_ints`
    trials: F32Ptr  # float32, see `tile_clusters.choose_group`


@inlined
def _power_of_two(n):
    """The least power of two that is at least n."""
    power = 1
    while power < n:
        power *= 2
    return power


@inlined
def tiles_to_fill(count):
    """The number of tiles with `count` samples each that fill the lanes."""
    return STRATA // _power_of_two(count)


@inlined
def bundle_of(tiles, count):
    """The `Bundle` of a number of tiles with `count` samples each."""
    size, strata = _power_of_two(tiles), _power_of_two(count)
    groups = STRATA // size if STRATA // size < strata else strata
    return Bundle(size, groups, strata // groups, False)


@inlined
def tile_group_of(scratch, chunk):
    """The `TileGroup` of a bundle. Its first tile is in the first slot."""
    union = tile_at(scratch.tiles, MAX_TILES, chunk)
    return tile_group_at(scratch.tile_group, scratch.tiles, scratch.valid, union, get(scratch.slots, 0))


@inlined
def lane_strata(lanes, bundle):
    """Bits of the strata in the groups `lanes` (bits) of a tile."""
    if bundle.strata == 1:
        return lanes
    ones, strata = (1 << bundle.strata) - 1, 0
    while lanes != 0:
        strata |= ones << (lowest_bit(lanes) * bundle.strata)
        lanes &= lanes - 1
    return strata


@inlined
def finished_groups(tile, valid, bundle):
    """Bits of the groups to which all segments from `valid` receivers (bits) are blocked."""
    strata, ones, groups = finished_strata(tile, valid), (1 << bundle.strata) - 1, 0
    for q in range(bundle.groups):
        if (strata >> (q * bundle.strata)) & ones == ones:
            groups |= 1 << q
    return groups


@kernel
def fill_lanes(slot, tile, bundle, lanes):
    """Write the shafts of a tile's groups to the lanes of a slot."""
    first_group = 16 // bundle.strata
    for q in range(bundle.groups):
        lane, group = slot * bundle.groups + q, first_group + q
        for k in range(3):
            low, high = get(tile.info, 6 + k), get(tile.info, 9 + k)
            put(lanes, 16 * k + lane, low)
            put(lanes, 48 + 16 * k + lane, high)
            put(lanes, 96 + 16 * k + lane, get(tile.groups, group + k * ALL_GROUPS) - low)
            put(lanes, 144 + 16 * k + lane, get(tile.groups, group + (3 + k) * ALL_GROUPS) - high)


@inlined
def shafts_of(p):
    """Load the `Shafts` of the lanes from p."""
    return Shafts(
        load16(p, 0), load16(p, 16), load16(p, 32), load16(p, 48), load16(p, 64), load16(p, 80),
        load16(p, 96), load16(p, 112), load16(p, 128), load16(p, 144), load16(p, 160), load16(p, 176),
    )  # fmt: skip


# --- Traversal of a bundle --------------------------------------------------------------------------------------------


@inlined
def _trace_tile(tree, link, tile, valid, strata, chunk, scratch, counters):
    """Test a block against the segments of a tile to `strata` (bits). Return whether it blocks any."""
    strata &= ~finished_strata(tile, valid)
    if strata == 0:
        return False
    before, (block, triangles), facing = load16(tile.dead, 0), block_leaf(link), chunk.query.facing
    trace_block(tile, tree, block, triangles, strata, valid, facing, scratch.work, scratch.deferred, counters)
    return bits(load16(tile.dead, 0) != before) != 0


@inlined
def _tile_group_leaf(tree, link, strata, chunk, scratch, counters):
    """Test a block against `strata` (bits) of a tile group.

    Return (bits of the strata to which all segments of the group are blocked, whether it blocks any segment).
    """
    tile_group, (block, triangles) = tile_group_of(scratch, chunk), block_leaf(link)
    ensure_filled(tile_group, chunk)
    live = tiles_by_beams(tile_group, ptr_at(tree.bounds, bounds_at(block)), strata, chunk)
    blocks, changed = False, 0
    if live < 0:
        work, deferred = scratch.work, scratch.deferred
        blocks = trace_tile_group(tile_group, tree, block, triangles, strata, chunk, work, deferred, counters)
        live = 0
    while live != 0:
        g = lowest_bit(live)
        live &= live - 1
        tile, valid = tile_in(tile_group, g, chunk), get(scratch.valid, g)
        copy_to_tile(tile_group, g, tile.dead)
        if _trace_tile(tree, link, tile, valid, strata, chunk, scratch, counters):
            changed |= 1 << g
    if changed != 0:
        copy_from_tiles(tile_group, changed, chunk)
    return finished(tile_group), blocks or changed != 0


@inlined
def _leaf(tree, link, mask, chunk, bundle, scratch, counters):
    """Test a block against the lanes in `mask`.

    Return (bits of the lanes whose segments are all blocked, whether it blocks any segment).
    """
    if bundle.is_tile_group:
        return _tile_group_leaf(tree, link, mask, chunk, scratch, counters)
    done, blocks, all_groups = 0, False, (1 << bundle.groups) - 1
    for slot in range(bundle.tiles):
        groups = mask >> (slot * bundle.groups) & all_groups
        if groups != 0:
            g = get(scratch.slots, slot)
            tile, valid = tile_at(scratch.tiles, g, chunk), get(scratch.valid, g)
            ensure_shafts(tile)
            blocks |= _trace_tile(tree, link, tile, valid, lane_strata(groups, bundle), chunk, scratch, counters)
            done |= (groups & finished_groups(tile, valid, bundle)) << (slot * bundle.groups)
    return done, blocks


class RegionJob(NamedTuple):
    """The job of `walk_tree` for a bundle: the bundle, and its chunk of the query."""

    chunk: QueryChunk
    bundle: Bundle


@overload(walk_tree)
def _by_job(tree, slabs, at, alive, job, scratch, counters):
    if job.instance_class is RegionJob:
        return lambda tree, slabs, at, alive, job, scratch, counters: _walk_tree(
            tree, slabs, at, alive, job, scratch, counters
        )


@inlined
def reset_blockers(scratch, tree):
    """Clear the list of blockers, for a new tree."""
    put(scratch.at, BLOCKERS, tree)
    for k in range(N_BLOCKERS):
        put(scratch.at, BLOCKERS + 1 + k, 0)  # the root: no leaf


@inlined
def _record_blocker(scratch, link):
    """Move a block that blocks all segments of a lane to the front of the list."""
    moved = np.int32(link)
    for k in range(N_BLOCKERS):
        old = get(scratch.at, BLOCKERS + 1 + k)
        put(scratch.at, BLOCKERS + 1 + k, moved)
        if old == link:
            return
        moved = old


@inlined
def _walk_tree(tree, slabs, at, alive, job, scratch, counters):
    """`walk_tree` of a bundle. A block is tested when the next one is reached; before, its box is prefetched.

    Blocks that blocked all segments of a lane of earlier bundles are tested first.
    """
    link, mask, blocks = get(scratch.at, WAITING), get(scratch.at, WAITING + 1), False
    tried, n_deferred = get(scratch.at, TRIED), get(scratch.deferred, 0)
    if get(scratch.at, BLOCKERS) != get(scratch.at, TREE):
        reset_blockers(scratch, get(scratch.at, TREE))
    while True:
        if tried >= N_BLOCKERS:
            at = next_leaf(tree, slabs, at, scratch.stack, alive, counters)
            if at.mask != 0:
                prefetch(tree.bounds, bounds_at(block_leaf(at.link).block))
        if mask & alive != 0:
            if get(scratch.deferred, 0) > DEFERRED:
                put(scratch.at, WAITING, link)
                put(scratch.at, WAITING + 1, mask)
                put(scratch.at, TRIED, tried)
                return at, alive, True
            done, any_ = _leaf(tree, link, mask & alive, job.chunk, job.bundle, scratch, counters)
            blocks |= any_
            if done != 0:
                _record_blocker(scratch, link)
                alive &= ~done
        if alive == 0 or (tried >= N_BLOCKERS and at.mask == 0):
            put(scratch.at, WAITING + 1, 0)
            put(scratch.at, TRIED, 0)
            return not_started(), alive, blocks or get(scratch.deferred, 0) != n_deferred
        if tried < N_BLOCKERS:
            link = get(scratch.at, BLOCKERS + 1 + tried)
            mask = alive if is_leaf(link) else 0
            tried += 1
        else:
            link, mask = at.link, at.mask if block_leaf(at.link).count != 0 else 0
            at = after_leaf(at)


@kernel
def _walk(tree_list, i, end, alive, chunk, bundle, scratch, counters):
    """`walk_tree_list` of a bundle."""
    slabs = slabs_of(shafts_of(scratch.lanes), alive)
    return walk_tree_list(tree_list, i, end, slabs, alive, RegionJob(chunk, bundle), scratch, counters)


@inlined
def trace_lanes(tree_list, y, x, alive, chunk, bundle, scratch, counters):
    """Trace the lanes in `alive`, of receivers near pixel (y, x), through their trees.

    Deferred tests are settled when their memory runs low, before a tree with separate arrays, and at the end.
    """
    i, end = list_of(tree_list, y, x, 0)
    save(scratch.at, not_started())
    put(scratch.at, WAITING + 1, 0)
    put(scratch.at, TRIED, 0)
    put(scratch.at, TREE, 0)
    while True:
        if i < end and alive != 0:
            i, alive = _walk(tree_list, i, end, alive, chunk, bundle, scratch, counters)
        if bundle.is_tile_group:
            copy_to_tiles(tile_group_of(scratch, chunk), chunk)
        if get(scratch.deferred, 0) != 0:
            corners = tree_in(tree_list, get(scratch.at, TREE)).corners
            resolve_deferred(corners, chunk, scratch.tiles, scratch.places, scratch.deferred, counters)
        if i >= end or alive == 0:
            return
