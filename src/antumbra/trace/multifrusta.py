"""`multifrusta`: 16 shafts of shadow rays at once through a shallow BVH, rays only where shafts do not decide.

Multi-frusta tracing [Benthin and Wald 2009] for area lights.
"""

from typing import NamedTuple

import numpy as np

from ..bvh.blocks import block_pointers
from ..bvh.nodes import MAX_DEPTH
from ..jit import inlined, kernel
from ..parallel import new_ticket, run, take, thread_count
from ..predicate.exact import segment
from ..query.shadow import horizon_of, is_above
from ..simd import get, load16, lowest_bit, ptr, ptr_at, put, stack_f32, stack_i32
from .counters import BOX_TESTS, NODES, UNCERTAIN, add_counters, count, private_counters
from .lighttable import ALL_GROUPS, STRATA, light_table, stays
from .shaftleaf import ASIDE, WORK, trace_block
from .shafts import make_shafts
from .slabs import (
    Shafts,
    children_mixed,
    children_uniform,
    least_direction,
    mixed_axis,
    uniform_axis,
    way_of,
)
from .tile import (
    TILE_FLOATS,
    TileShape,
    apply_horizon,
    asked_of,
    bound_receivers,
    coherent_part,
    load_receivers,
    move_light,
    place_of,
    sets_of,
    tile_at,
    tile_shape,
    write_bits,
)
from .traverse import settle

_STACK = 4 * MAX_DEPTH
_LANES = 12 * 16
_F = np.float32
MAX_TILES = 16
_SCRATCH = MAX_TILES * TILE_FLOATS
_FINISHED = MAX_TILES
_VALID = 2 * MAX_TILES
_AT = 4 + 2 * MAX_TILES
TILES = 4  # of a bundle, as long as they fill its lanes
_ASIDE = 2 + 2 * (1 + TILES) * ASIDE  # with room for all that is put aside at one more block


class Bundle(NamedTuple):
    """How the 16 lanes of a bundle share its tiles and strata."""

    tiles: int  # 1 to 16, a power of two
    groups: int  # groups of strata of each tile: lanes are tile * groups + group
    strata: int  # strata in a group


class Layout(NamedTuple):
    """How a picture's tiles are cut into bundles."""

    across: int  # tiles in a row of a bundle
    down: int
    columns: int  # bundles in a row
    rows: int


class Scratch(NamedTuple):
    """A thread's memory."""

    tiles: object  # float32, MAX_TILES tiles
    lanes: object  # float32, rows of `Shafts`
    work: object  # float32, for `shaftleaf`
    stack: object  # int32: links and masks
    valid: object  # int32: bits of each tile's receivers; from _FINISHED on, bits of its finished strata
    planes: object  # float32, for `tile.apply_horizon`
    at: object  # int32: link, mask and stack height where a walk goes on; from 4 on, y and x of each tile
    aside: object  # int32: how many, nothing, then slot and place of each segment that float32 cannot decide


@inlined
def _lane_strata(lanes, bundle):
    """The strata (bits) of the groups (bits)."""
    if bundle.strata == 1:
        return lanes
    ones, strata = (np.int64(1) << bundle.strata) - 1, np.int64(0)
    while lanes != 0:
        strata |= ones << (lowest_bit(lanes) * bundle.strata)
        lanes &= lanes - 1
    return strata


@kernel
def _fill_lanes(g, tile, bundle, lanes):
    """The shafts of a tile's groups."""
    first_group = 16 // bundle.strata
    for q in range(bundle.groups):
        lane, group = g * bundle.groups + q, first_group + q
        for k in range(3):
            low, high = get(tile.info, 6 + k), get(tile.info, 9 + k)
            put(lanes, 16 * k + lane, low)
            put(lanes, 48 + 16 * k + lane, high)
            put(lanes, 96 + 16 * k + lane, get(tile.groups, group + k * ALL_GROUPS) - low)
            put(lanes, 144 + 16 * k + lane, get(tile.groups, group + (3 + k) * ALL_GROUPS) - high)


@inlined
def _shafts(p):
    return Shafts(
        load16(p, 0), load16(p, 16), load16(p, 32), load16(p, 48), load16(p, 64), load16(p, 80),
        load16(p, 96), load16(p, 112), load16(p, 128), load16(p, 144), load16(p, 160), load16(p, 176),
    )  # fmt: skip


@inlined
def _leaf(tree, code, mask, asked, bundle, scratch, counters):
    """A block against the lanes in `mask`; bits of the lanes that have no segment left."""
    block, triangles, done = code >> 5, code & 31, np.int64(0)
    all_groups = (np.int64(1) << bundle.groups) - 1
    for g in range(bundle.tiles):
        groups = mask >> (g * bundle.groups) & all_groups
        if groups != 0:
            tile = tile_at(scratch.tiles, g, asked)
            valid, finished = np.int64(get(scratch.valid, g)), np.int64(get(scratch.valid, _FINISHED + g))
            strata = _lane_strata(groups, bundle) & ~finished
            now = trace_block(
                tile, tree, block, triangles, strata, valid, asked.facing, scratch.work, scratch.aside, counters
            )
            if now != 0:
                put(scratch.valid, _FINISHED + g, finished | now)
                done |= _finished_groups(finished | now, bundle) << (g * bundle.groups)
    return done


@inlined
def _finished_groups(strata, bundle):
    """Groups all of whose strata are among the given ones."""
    ones, groups = (np.int64(1) << bundle.strata) - 1, np.int64(0)
    for q in range(bundle.groups):
        if (strata >> (q * bundle.strata)) & ones == ones:
            groups |= np.int64(1) << q
    return groups


@kernel
def _walk(tree, alive, asked, bundle, scratch, counters):
    """Trace the lanes in `alive` through the tree."""
    s = _shafts(scratch.lanes)
    limit = least_direction(s)
    wx, wy, wz = (
        way_of(s.dx_low, s.dx_high, limit, alive),
        way_of(s.dy_low, s.dy_high, limit, alive),
        way_of(s.dz_low, s.dz_high, limit, alive),
    )
    uniform = wx != 0 and wy != 0 and wz != 0
    ux = uniform_axis(s.ox_low, s.ox_high, s.dx_low, s.dx_high, limit, wx)
    uy = uniform_axis(s.oy_low, s.oy_high, s.dy_low, s.dy_high, limit, wy)
    uz = uniform_axis(s.oz_low, s.oz_high, s.dz_low, s.dz_high, limit, wz)
    mx = mixed_axis(s.ox_low, s.ox_high, s.dx_low, s.dx_high, limit)
    my = mixed_axis(s.oy_low, s.oy_high, s.dy_low, s.dy_high, limit)
    mz = mixed_axis(s.oz_low, s.oz_high, s.dz_low, s.dz_high, limit)
    link, mask, height = (
        np.int64(get(scratch.at, 0)),
        np.int64(get(scratch.at, 1)) & alive,
        np.int64(get(scratch.at, 2)),
    )
    while True:
        while mask == 0:
            if height == 0:
                return np.int64(0)
            height -= 2
            link, mask = np.int64(get(scratch.stack, height)), np.int64(get(scratch.stack, height + 1)) & alive
        if link >= 0:
            count(counters, NODES, 1)
            count(counters, BOX_TESTS, 2)
            if uniform:
                left, right = children_uniform(tree.nodes, link, ux, uy, uz)
            else:
                left, right = children_mixed(tree.nodes, link, mx, my, mz)
            left &= mask
            right &= mask
            if left != 0 and right != 0:
                put(scratch.stack, height, get(tree.links, link * 16 + 13))
                put(scratch.stack, height + 1, right)
                height += 2
            link = np.int64(get(tree.links, link * 16 + (12 if left != 0 else 13)))
            mask = left if left != 0 else right
            continue
        if np.int64(get(scratch.aside, 0)) > ASIDE:
            put(scratch.at, 0, link)
            put(scratch.at, 1, mask)
            put(scratch.at, 2, height)
            return alive
        if ~link & 31 != 0:
            alive &= ~_leaf(tree, ~link, mask, asked, bundle, scratch, counters)
        mask = np.int64(0)


@kernel
def _settle_aside(tree, query, asked, scratch, counters):
    """Decide exactly what float32 could not say about a bundle's segments."""
    for k in range(np.int64(get(scratch.aside, 0))):
        slot, code = np.int64(get(scratch.aside, 2 + 2 * k)), np.int64(get(scratch.aside, 3 + 2 * k))
        g, s, lane = code >> 8, code >> 4 & 15, code & 15
        tile = tile_at(scratch.tiles, g, asked)
        dead = np.int64(get(tile.dead, s))
        if (dead >> lane | np.int64(get(scratch.valid, _FINISHED + g)) >> s) & 1 == 0:
            o, l = lane, s * 48 + lane
            ray = segment(
                get(tile.origins, o), get(tile.origins, o + 16), get(tile.origins, o + 32),
                get(tile.points, l), get(tile.points, l + 16), get(tile.points, l + 32),
            )  # fmt: skip
            if slot < 0:
                at = place_of(asked, np.int64(get(scratch.at, 4 + 2 * g)), np.int64(get(scratch.at, 5 + 2 * g)), lane)
                horizon = horizon_of(query, at // asked.w, at % asked.w)
                count(counters, UNCERTAIN, 1)
                l_at = ptr_at(tile.points, l)
                blocked = not is_above(horizon, get(l_at, 0), get(l_at, 16), get(l_at, 32), query.corners)
            else:
                side = settle(ray, tree.corners, slot, counters)
                blocked = side != 0 and side != asked.facing
            if blocked:
                put(tile.dead, s, dead | np.int64(1) << lane)
    put(scratch.aside, 0, 0)


@inlined
def _trace_lanes(tree, alive, query, asked, bundle, scratch, counters):
    """Trace the lanes in `alive`, and settle what is put aside whenever the memory for it runs low, and at the end."""
    put(scratch.at, 0, 0)
    put(scratch.at, 1, alive)
    put(scratch.at, 2, 0)
    while True:
        if alive != 0:
            alive = _walk(tree, alive, asked, bundle, scratch, counters)
        if np.int64(get(scratch.aside, 0)) != 0:
            _settle_aside(tree, query, asked, scratch, counters)
        if alive == 0:
            return


@inlined
def _start_tile(asked, y0, x0, bundle, tile, valid, scratch, counters):
    """Prepare a tile of a bundle; bits of its lanes that have a segment to trace."""
    g = tile.number
    put(scratch.at, 4 + 2 * g, y0)
    put(scratch.at, 5 + 2 * g, x0)
    make_shafts(tile.info, tile.groups, tile.shafts)
    apply_horizon(asked, y0, x0, valid, tile, scratch.planes, scratch.aside, counters)
    finished = np.int64(0)
    for s in range(16):
        if s >= asked.count or np.int64(get(tile.dead, s)) & valid == valid:
            finished |= np.int64(1) << s
    put(scratch.valid, _FINISHED + g, finished)
    _fill_lanes(g, tile, bundle, scratch.lanes)
    groups = ((np.int64(1) << bundle.groups) - 1) & ~_finished_groups(finished, bundle)
    return groups << (g * bundle.groups)


@inlined
def _finish_tile(asked, tile, scratch, out):
    """Write the bits of a tile."""
    g = tile.number
    valid, finished = np.int64(get(scratch.valid, g)), np.int64(get(scratch.valid, _FINISHED + g))
    if valid != 0:
        y0, x0 = np.int64(get(scratch.at, 4 + 2 * g)), np.int64(get(scratch.at, 5 + 2 * g))
        write_bits(asked, y0, x0, valid, tile, finished, out)


@kernel
def _trace_bundles(ticket, arrays, query, table, shape, layout, bundle, alone, chunk, n_samples, out, counters):
    """Worker: bundles of tiles; then, one place after the other, the tiles whose receivers lie in several places."""
    scratch = Scratch(
        stack_f32(_SCRATCH), stack_f32(_LANES), stack_f32(WORK), stack_i32(_STACK), stack_i32(_VALID), stack_f32(128),
        stack_i32(_AT), stack_i32(_ASIDE),
    )  # fmt: skip
    fixed = stays(query.light)
    tree, mine = block_pointers(arrays), private_counters(counters)
    asked, places = asked_of(query, table, shape, chunk, n_samples, fixed), ptr(out)
    put(scratch.aside, 0, 0)
    at = take(ticket)
    while at >= 0:
        by, bx = at // layout.columns * layout.down, at % layout.columns * layout.across
        alive, apart = np.int64(0), np.int64(0)
        for g in range(bundle.tiles):
            y0, x0 = (by + g // layout.across) * shape.height, (bx + g % layout.across) * shape.width
            tile = tile_at(scratch.tiles, g, asked)
            valid = load_receivers(asked, y0, x0, tile)
            if coherent_part(tile, valid, asked.light) != valid:
                apart |= np.int64(1) << g
                valid = np.int64(0)
            put(scratch.valid, g, valid)
            if valid != 0:
                bound_receivers(tile, valid)
                if not fixed:
                    move_light(query, y0, x0, shape, chunk, valid, tile, asked.count)
                alive |= _start_tile(asked, y0, x0, bundle, tile, valid, scratch, mine)
        job, left, g = bundle, np.int64(0), np.int64(0)
        while True:
            _trace_lanes(tree, alive, query, asked, job, scratch, mine)
            for i in range(job.tiles):
                _finish_tile(asked, tile_at(scratch.tiles, i, asked), scratch, places)
            if left == 0:
                if apart == 0:
                    break
                g, left = lowest_bit(apart), np.int64(0xFFFF)
                apart &= apart - 1
            y0, x0 = (by + g // layout.across) * shape.height, (bx + g % layout.across) * shape.width
            job, tile = alone, tile_at(scratch.tiles, 0, asked)
            left &= load_receivers(asked, y0, x0, tile)
            part = coherent_part(tile, left, asked.light)
            left &= ~part
            put(scratch.valid, 0, part)
            bound_receivers(tile, part)
            if not fixed:
                move_light(query, y0, x0, shape, chunk, part, tile, asked.count)
            alive = _start_tile(asked, y0, x0, alone, tile, part, scratch, mine)
        at = take(ticket)
    add_counters(counters, mine)


def _bundles(count: int, tiles: int) -> tuple[Bundle, Bundle]:
    """For `count` samples: a bundle of `tiles` tiles, or more if they are needed to fill the lanes; one of one tile."""
    strata = 1 << (count - 1).bit_length()
    tiles = max(tiles, STRATA // strata)
    return Bundle(tiles, STRATA // tiles, strata * tiles // STRATA), Bundle(1, strata, 1)


def _layout(shape: TileShape, tiles: int) -> Layout:
    across = tiles if shape.height == 1 else 1 << (tiles.bit_length() // 2)
    down = tiles // across
    return Layout(across, down, -(-shape.columns // across), -(-shape.rows // down))


def trace_shadow(tree, query, bits, threads=None, counters=None, progress=None) -> None:
    """Answer a ShadowQuery: set bit s of ``bits[y, x]`` where sample s is occluded.

    tree : BlockTree
    bits : (h, w, ceil(spp / 64)) uint64, zeros on entry
    counters : from `new_counters`, or None
    """
    shape, spp = tile_shape(query), query.samples.shape[1]
    table = light_table(query, sets_of(shape))
    for chunk in range(-(-spp // STRATA)):
        count = min(STRATA, spp - chunk * STRATA)
        bundle, alone = _bundles(count, TILES)
        layout = _layout(shape, bundle.tiles)
        run(
            _trace_bundles,
            thread_count(threads),
            new_ticket(layout.columns * layout.rows, 1),
            tree,
            query,
            table,
            shape,
            layout,
            bundle,
            alone,
            chunk,
            count,
            bits,
            counters,
            progress=progress,
        )
