"""`multifrusta`: trace 16 shafts of shadow rays at once through a shallow BVH.

Single rays are tested only where shafts do not decide. This is multi-frusta tracing [Benthin and Wald 2009] for area
lights.
"""

from typing import NamedTuple

import numpy as np

from ...bvh.nodes import boxes_of
from ...kernels.jit import inlined, kernel, overload
from ...kernels.parallel import new_ticket, run, take, thread_count
from ...kernels.simd import get, lowest_bit, popcount, prefetch, ptr, ptr_at, put, stack_f32, stack_i32, stack_i64
from ...scene.lights import is_list
from ..beams import make_beams
from ..blocktest import fetch
from ..counters import N_COUNTERS, TILE_GROUP_TILES, add_counters, cleared, count, new_counters
from ..deferred import DEFERRED, settle_deferred
from ..descent import left, next_leaf, nowhere, save, slabs_of
from ..forest import TREE, Forest, forest_pointers, is_idle, list_of, tree_in, walk_forest, walk_tree, whole
from ..horizon import PLANES, apply_horizon
from ..lighttable import STRATA, light_table
from ..packets.incoherent import extents_of, is_far, is_huge, is_incoherent
from ..packets.packet16 import over_pixels, over_samples
from ..querychunk import QueryChunk, query_chunk_of, sets_of, tile_shape
from ..segmentbox import forget_inverses
from ..shafts import make_shafts
from ..tile import bound_receivers, finished_strata, first_pixel, move_light, read_bits, tile_at, write_bits
from .bundle import (
    AT,
    BLOCKERS,
    DEFERRED_INTS,
    LANES,
    MAX_TILES,
    N_BLOCKERS,
    PLACES,
    STACK,
    TILES,
    WAITING,
    Bundle,
    Scratch,
    bundle_of,
    fill_lanes,
    finished_groups,
    lane_strata,
    shafts_of,
    tile_group_of,
    tiles_to_fill,
)
from .region import RUN, corner_of, layout_of, near_each_other, next_parts, runs
from .shaftleaf import WORK, trace_block
from .tilegroup import TILE_GROUP_FLOATS, close, finished, make_tile_group, tile_in, tiles_by_beams, trace_tile_group

_INTERLEAVED = 4  # least number of tiles in a bundle with separate shafts
_FEW_TILES = 12  # least number of tiles in a tile group; fewer do not pay for its wider shafts
_FEW_SAMPLES = 8  # least number of samples in a chunk for a tile group


@inlined
def _trace_tile(tree, code, tile, valid, strata, chunk, scratch, counters):
    """Test a block against the segments of a tile to some strata (bits)."""
    strata &= ~finished_strata(tile, valid)
    if strata != 0:
        block, triangles, facing = code >> 5, code & 31, chunk.query.facing
        trace_block(tile, tree, block, triangles, strata, valid, facing, scratch.work, scratch.deferred, counters)


@inlined
def _tile_group_leaf(tree, code, strata, chunk, scratch, counters):
    """Test a block against some strata (bits) of a tile group.

    Return bits of the strata to which the group has no segment left.
    """
    tile_group, block = tile_group_of(scratch, chunk), code >> 5
    live = tiles_by_beams(tile_group, ptr_at(tree.bounds, block * 8), strata, chunk)
    if live < 0:
        trace_tile_group(tile_group, tree, block, code & 31, strata, chunk, scratch.work, scratch.deferred, counters)
        live = np.int64(0)
    while live != 0:
        g = lowest_bit(live)
        live &= live - 1
        tile, valid = tile_in(tile_group, g, chunk), np.int64(get(scratch.valid, g))
        _trace_tile(tree, code, tile, valid, strata, chunk, scratch, counters)
        close(tile_group, g, finished_strata(tile, valid))
    return finished(tile_group)


@inlined
def _leaf(tree, code, mask, chunk, bundle, scratch, counters):
    """Test a block against the lanes in `mask`. Return bits of the lanes that have no segment left."""
    if bundle.is_tile_group:
        return _tile_group_leaf(tree, code, mask, chunk, scratch, counters)
    done, all_groups = np.int64(0), (np.int64(1) << bundle.groups) - 1
    for slot in range(bundle.tiles):
        groups = mask >> (slot * bundle.groups) & all_groups
        if groups != 0:
            g = np.int64(get(scratch.slots, slot))
            tile, valid = tile_at(scratch.tiles, g, chunk), np.int64(get(scratch.valid, g))
            _trace_tile(tree, code, tile, valid, lane_strata(groups, bundle), chunk, scratch, counters)
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
def _forget_blockers(scratch, tree):
    """Note that no block of a tree is known to block all segments of a lane."""
    put(scratch.at, BLOCKERS, tree)
    for k in range(N_BLOCKERS):
        put(scratch.at, BLOCKERS + 1 + k, -1)


@inlined
def _remember_blocker(scratch, code):
    """Put a block that blocks all segments of a lane in front of those known."""
    moved = np.int32(code)
    for k in range(N_BLOCKERS):
        old = get(scratch.at, BLOCKERS + 1 + k)
        put(scratch.at, BLOCKERS + 1 + k, moved)
        if old == code:
            return
        moved = old


@inlined
def _walk_tree(tree, slabs, at, alive, job, scratch, counters):
    """`walk_tree` of a bundle. It prefetches a block when it finds it, and tests it when it finds the next one.

    First it tests blocks that blocked all segments of a lane in the bundles before.
    """
    code, mask = np.int64(get(scratch.at, WAITING)), np.int64(get(scratch.at, WAITING + 1))
    known = np.int64(N_BLOCKERS)
    if at.place == -1:
        known = np.int64(0)
        if get(scratch.at, BLOCKERS) != get(scratch.at, TREE):
            _forget_blockers(scratch, np.int64(get(scratch.at, TREE)))
    while True:
        if known >= N_BLOCKERS:
            at = next_leaf(tree, slabs, at, scratch.stack, alive, counters)
            if at.mask != 0:
                prefetch(tree.bounds, (~at.link >> 5) * 8)
                fetch(tree, at.link)
        if mask & alive != 0:
            if np.int64(get(scratch.deferred, 0)) > DEFERRED:
                put(scratch.at, WAITING, code)
                put(scratch.at, WAITING + 1, mask)
                return at, alive
            done = _leaf(tree, code, mask & alive, job.chunk, job.bundle, scratch, counters)
            if done != 0:
                _remember_blocker(scratch, code)
                alive &= ~done
        if alive == 0 or (known >= N_BLOCKERS and at.mask == 0):
            put(scratch.at, WAITING + 1, 0)
            return nowhere(), alive
        if known < N_BLOCKERS:
            code = np.int64(get(scratch.at, BLOCKERS + 1 + known))
            mask = alive if code >= 0 else np.int64(0)
            known += 1
        else:
            code, mask = ~at.link, at.mask if ~at.link & 31 != 0 else np.int64(0)
            at = left(at)


@kernel
def _walk(forest, i, end, alive, chunk, bundle, scratch, counters):
    """`walk_forest` of a bundle."""
    slabs = slabs_of(shafts_of(scratch.lanes), alive)
    return walk_forest(forest, i, end, slabs, alive, RegionJob(chunk, bundle), scratch, counters)


@inlined
def _trace_lanes(forest, y, x, alive, chunk, bundle, scratch, counters):
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
        if np.int64(get(scratch.deferred, 0)) != 0:
            corners = tree_in(forest, np.int64(get(scratch.at, TREE))).corners
            settle_deferred(corners, chunk, scratch.tiles, scratch.places, scratch.deferred, counters)
        if i >= end or alive == 0:
            return


@inlined
def _start_tile(chunk, g, scratch, fresh, known, counters):
    """Prepare tile g, whose receivers are loaded. Return whether it has a segment to trace.

    Unless `fresh`, the bits at `known` give the blocked segments.
    """
    tile, valid = tile_at(scratch.tiles, g, chunk), np.int64(get(scratch.valid, g))
    y0, x0 = first_pixel(scratch.places, g)
    bound_receivers(tile, valid)
    if not chunk.fixed:
        move_light(chunk, y0, x0, valid, tile)
    if fresh:
        apply_horizon(chunk, y0, x0, valid, tile, scratch.planes, scratch.deferred, counters)
    else:
        read_bits(chunk, y0, x0, valid, tile, known)
    if finished_strata(tile, valid) == 0xFFFF:
        return False
    make_beams(tile)
    forget_inverses(tile)
    return True


@inlined
def _fill_slot(chunk, bundle, slot, g, scratch):
    """Give tile g a slot of a bundle. Return bits of its lanes that have a segment to trace."""
    tile = tile_at(scratch.tiles, g, chunk)
    make_shafts(tile.info, tile.groups, tile.shafts)
    put(scratch.slots, slot, g)
    fill_lanes(slot, tile, bundle, scratch.lanes)
    groups = ~finished_groups(tile, np.int64(get(scratch.valid, g)), bundle) & ((np.int64(1) << bundle.groups) - 1)
    return groups << (slot * bundle.groups)


@inlined
def _bundle_separate(numbers, chunk, scratch):
    """Make a `Bundle` of the first of some tiles (bits), each with its own shafts.

    Return the bundle, bits of its live lanes, and bits of the tiles left.
    """
    n = min(popcount(numbers), max(_INTERLEAVED, tiles_to_fill(chunk.count)))
    bundle, alive = bundle_of(n, chunk.count), np.int64(0)
    for slot in range(n):
        alive |= _fill_slot(chunk, bundle, slot, lowest_bit(numbers), scratch)
        numbers &= numbers - 1
    return bundle, alive, numbers


@inlined
def _bundle_together(members, chunk, scratch, counters):
    """Make a `Bundle` of some tiles (bits) as a tile group. Return the bundle and bits of its live lanes."""
    count(counters, TILE_GROUP_TILES, popcount(members))
    put(scratch.slots, 0, lowest_bit(members))
    bundle, tile_group = Bundle(np.int64(1), np.int64(STRATA), np.int64(1), True), tile_group_of(scratch, chunk)
    make_tile_group(tile_group, members, chunk)
    fill_lanes(np.int64(0), tile_group.whole, bundle, scratch.lanes)
    return bundle, ~finished(tile_group) & 0xFFFF


@inlined
def _tile_group_among(numbers, chunk, scratch):
    """Bits of the region's tiles in `numbers` (bits) that form a tile group, 0 if none do. A region has at most one."""
    while popcount(numbers) >= _FEW_TILES and chunk.count >= _FEW_SAMPLES:
        members = near_each_other(chunk, scratch.tiles, numbers)
        if popcount(members) >= _FEW_TILES:
            return members
        numbers &= ~members
    return np.int64(0)


@inlined
def _trace_parts(forest, n, chunk, scratch, known, counters):
    """Trace n tiles whose receivers are loaded. If some of them form a tile group, it comes first."""
    (y, x), live = first_pixel(scratch.places, 0), np.int64(0)
    for g in range(n):
        if _start_tile(chunk, g, scratch, forest.fresh, known, counters):
            live |= np.int64(1) << g
    members = _tile_group_among(live, chunk, scratch)
    separate = live & ~members
    while members | separate != 0:
        if members != 0:
            bundle, alive = _bundle_together(members, chunk, scratch, counters)
            members = np.int64(0)
        else:
            bundle, alive, separate = _bundle_separate(separate, chunk, scratch)
        _trace_lanes(forest, y, x, alive, chunk, bundle, scratch, counters)


@kernel
def _trace_regions(ticket, arrays, query, table, shape, layout, k, n_samples, out, counters):
    """Worker: trace regions of tiles. If a tile's receivers lie in several places, it traces one place after the other.

    layout : Layout
    k : number of the chunk
    n_samples : samples in the chunk
    out : the bits of all receivers
    """
    # In: query, table, shape, layout, k, n_samples. Out: out, counters.
    scratch = Scratch(
        stack_f32(TILES), stack_f32(LANES), stack_f32(WORK), stack_f32(TILE_GROUP_FLOATS), stack_i32(STACK),
        stack_i32(MAX_TILES), stack_i32(MAX_TILES), stack_i32(MAX_TILES), stack_i32(PLACES), stack_f32(PLANES),
        stack_i32(AT), stack_i32(DEFERRED_INTS),
    )  # fmt: skip
    forest, mine = forest_pointers(arrays), cleared(stack_i64(N_COUNTERS))
    chunk, places = query_chunk_of(query, table, shape, k, n_samples), ptr(out)
    put(scratch.deferred, 0, 0)
    at = take(ticket)
    while at >= 0:
        y, x = corner_of(layout, at)
        idle = is_idle(forest, y * shape.height, x * shape.width)
        for g in range(MAX_TILES):
            put(scratch.left, g, np.int32(0 if idle else 0xFFFF))
        n = next_parts(chunk, layout, y, x, scratch)
        _forget_blockers(scratch, np.int64(-1))
        while n > 0:
            _trace_parts(forest, n, chunk, scratch, places, mine)
            for g in range(n):
                y0, x0 = first_pixel(scratch.places, g)
                write_bits(chunk, y0, x0, np.int64(get(scratch.valid, g)), tile_at(scratch.tiles, g, chunk), places)
            n = next_parts(chunk, layout, y, x, scratch)
        at = take(ticket)
    add_counters(counters, mine)


def trace_shadow(tree, query, bits, threads=None, counters=None, progress=None) -> None:
    """Answer a ShadowQuery: set bit s of ``bits[y, x]`` where sample s is occluded.

    Packets trace the queries that shafts cannot trace well (`packets.incoherent`). These are hemispheres, interleaved
    lists, huge lights, and coordinates too large for shafts.

    tree : BlockTree
    bits : (h, w, ceil(spp / 64)) uint64, zeros on entry
    counters : from `new_counters`, or None
    """
    if is_incoherent(query) or is_huge(query, extents_of(tree)) or is_far(query, boxes_of(tree.nodes[:1])):
        by_packets = over_samples if is_list(query.light) else over_pixels
        by_packets(tree, query, bits, threads, counters, progress)
        return
    trace_forest(whole(tree), query, bits, threads, counters, progress)


def trace_forest(forest: Forest, query, bits, threads=None, counters=None, progress=None, chunks=None) -> None:
    """Trace shafts through the trees of a `Forest`; arguments as for `trace_shadow`.

    bits : zeros; if the forest is not fresh, the blocked segments found so far
    chunks : range of the chunks of 16 samples to trace; None: all
    """
    counters = new_counters() if counters is None else counters
    shape, spp = tile_shape(query), query.samples.shape[1]
    table, layout = light_table(query, sets_of(shape)), layout_of(shape)
    for chunk in range(-(-spp // STRATA)) if chunks is None else chunks:
        count = min(STRATA, spp - chunk * STRATA)
        ticket = new_ticket(runs(layout) * RUN, 1)
        arrays = forest, query, table, shape, layout, chunk, count, bits, counters
        run(_trace_regions, thread_count(threads), ticket, *arrays, progress=progress)
