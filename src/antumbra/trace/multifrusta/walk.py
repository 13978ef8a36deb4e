"""The walk of a bundle through the trees of a forest, and its tests of the blocks that it finds."""

from typing import NamedTuple

import numpy as np

from ...bvh.links import block_leaf, bounds_at, is_leaf
from ...kernels.jit import inlined, kernel, overload
from ...kernels.simd import bits, get, load16, lowest_bit, prefetch, ptr_at, put
from ..blocktest import fetch
from ..deferred import DEFERRED, settle_deferred
from ..descent import left, next_leaf, nowhere, save, slabs_of
from ..forest import TREE, list_of, tree_in, walk_forest, walk_tree
from ..querychunk import QueryChunk
from ..shafts import have_shafts
from ..tile import finished_strata, tile_at
from .bundle import (
    BLOCKERS,
    N_BLOCKERS,
    WAITING,
    Bundle,
    finished_groups,
    lane_strata,
    shafts_of,
    tile_group_of,
)
from .shaftleaf import trace_block
from .tilegroup import (
    be_filled,
    finished,
    give_to_tile,
    give_to_tiles,
    take_from_tiles,
    tile_in,
    tiles_by_beams,
    trace_tile_group,
)


@inlined
def _trace_tile(tree, link, tile, valid, strata, chunk, scratch, counters):
    """Test a block against the segments of a tile to some strata (bits)."""
    strata &= ~finished_strata(tile, valid)
    if strata != 0:
        (block, triangles), facing = block_leaf(link), chunk.query.facing
        trace_block(tile, tree, block, triangles, strata, valid, facing, scratch.work, scratch.deferred, counters)


@inlined
def _tile_group_leaf(tree, link, strata, chunk, scratch, counters):
    """Test a block against some strata (bits) of a tile group.

    Return bits of the strata to which the group has no segment left.
    """
    tile_group, (block, triangles) = tile_group_of(scratch, chunk), block_leaf(link)
    be_filled(tile_group, chunk)
    live = tiles_by_beams(tile_group, ptr_at(tree.bounds, bounds_at(block)), strata, chunk)
    if live < 0:
        trace_tile_group(tile_group, tree, block, triangles, strata, chunk, scratch.work, scratch.deferred, counters)
        live = np.int64(0)
    changed = np.int64(0)
    while live != 0:
        g = lowest_bit(live)
        live &= live - 1
        tile, valid = tile_in(tile_group, g, chunk), np.int64(get(scratch.valid, g))
        give_to_tile(tile_group, g, tile.dead)
        before = load16(tile.dead, 0)
        _trace_tile(tree, link, tile, valid, strata, chunk, scratch, counters)
        if bits(load16(tile.dead, 0) != before) != 0:
            changed |= np.int64(1) << g
    if changed != 0:
        take_from_tiles(tile_group, changed, chunk)
    return finished(tile_group)


@inlined
def _leaf(tree, link, mask, chunk, bundle, scratch, counters):
    """Test a block against the lanes in `mask`. Return bits of the lanes that have no segment left."""
    if bundle.is_tile_group:
        return _tile_group_leaf(tree, link, mask, chunk, scratch, counters)
    done, all_groups = np.int64(0), (np.int64(1) << bundle.groups) - 1
    for slot in range(bundle.tiles):
        groups = mask >> (slot * bundle.groups) & all_groups
        if groups != 0:
            g = np.int64(get(scratch.slots, slot))
            tile, valid = tile_at(scratch.tiles, g, chunk), np.int64(get(scratch.valid, g))
            have_shafts(tile)
            _trace_tile(tree, link, tile, valid, lane_strata(groups, bundle), chunk, scratch, counters)
            done |= (groups & finished_groups(tile, valid, bundle)) << (slot * bundle.groups)
    return done


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
def forget_blockers(scratch, tree):
    """Note that no block of a tree is known to block all segments of a lane."""
    put(scratch.at, BLOCKERS, tree)
    for k in range(N_BLOCKERS):
        put(scratch.at, BLOCKERS + 1 + k, 0)  # the root: no leaf


@inlined
def _remember_blocker(scratch, link):
    """Put a block that blocks all segments of a lane in front of those known."""
    moved = np.int32(link)
    for k in range(N_BLOCKERS):
        old = get(scratch.at, BLOCKERS + 1 + k)
        put(scratch.at, BLOCKERS + 1 + k, moved)
        if old == link:
            return
        moved = old


@inlined
def _walk_tree(tree, slabs, at, alive, job, scratch, counters):
    """`walk_tree` of a bundle. It prefetches a block when it finds it, and tests it when it finds the next one.

    First it tests blocks that blocked all segments of a lane in the bundles before.
    """
    link, mask = np.int64(get(scratch.at, WAITING)), np.int64(get(scratch.at, WAITING + 1))
    known = np.int64(N_BLOCKERS)
    if at.place == -1:
        known = np.int64(0)
        if get(scratch.at, BLOCKERS) != get(scratch.at, TREE):
            forget_blockers(scratch, np.int64(get(scratch.at, TREE)))
    while True:
        if known >= N_BLOCKERS:
            at = next_leaf(tree, slabs, at, scratch.stack, alive, counters)
            if at.mask != 0:
                prefetch(tree.bounds, bounds_at(block_leaf(at.link).block))
                fetch(tree, at.link)
        if mask & alive != 0:
            if np.int64(get(scratch.deferred, 0)) > DEFERRED:
                put(scratch.at, WAITING, link)
                put(scratch.at, WAITING + 1, mask)
                return at, alive
            done = _leaf(tree, link, mask & alive, job.chunk, job.bundle, scratch, counters)
            if done != 0:
                _remember_blocker(scratch, link)
                alive &= ~done
        if alive == 0 or (known >= N_BLOCKERS and at.mask == 0):
            put(scratch.at, WAITING + 1, 0)
            return nowhere(), alive
        if known < N_BLOCKERS:
            link = np.int64(get(scratch.at, BLOCKERS + 1 + known))
            mask = alive if is_leaf(link) else np.int64(0)
            known += 1
        else:
            link, mask = at.link, at.mask if block_leaf(at.link).count != 0 else np.int64(0)
            at = left(at)


@kernel
def _walk(forest, i, end, alive, chunk, bundle, scratch, counters):
    """`walk_forest` of a bundle."""
    slabs = slabs_of(shafts_of(scratch.lanes), alive)
    return walk_forest(forest, i, end, slabs, alive, RegionJob(chunk, bundle), scratch, counters)


@inlined
def trace_lanes(forest, y, x, alive, chunk, bundle, scratch, counters):
    """Trace the lanes in `alive`, of receivers near pixel (y, x), through their trees.

    Deferred tests are settled in three cases: when their memory runs low, before a tree with other arrays, and at the
    end.
    """
    i, end = list_of(forest, y, x, np.int64(0))
    save(scratch.at, nowhere())
    put(scratch.at, WAITING + 1, 0)
    put(scratch.at, TREE, 0)
    while True:
        if i < end and alive != 0:
            i, alive = _walk(forest, i, end, alive, chunk, bundle, scratch, counters)
        if bundle.is_tile_group:
            give_to_tiles(tile_group_of(scratch, chunk), chunk)
        if np.int64(get(scratch.deferred, 0)) != 0:
            corners = tree_in(forest, np.int64(get(scratch.at, TREE))).corners
            settle_deferred(corners, chunk, scratch.tiles, scratch.places, scratch.deferred, counters)
        if i >= end or alive == 0:
            return
