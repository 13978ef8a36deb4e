"""`multifrusta`: 16 shafts of shadow rays at once through a shallow BVH, rays only where shafts do not decide.

Multi-frusta tracing [Benthin and Wald 2009] for area lights.
"""

from typing import NamedTuple

import numpy as np

from ..bvh.blocks import block_pointers
from ..bvh.nodes import MAX_DEPTH
from ..jit import inlined, kernel
from ..parallel import new_ticket, run, take, thread_count
from ..scene.lights import FIXED
from ..simd import get, load16, lowest_bit, ptr_at, put, stack_f32, stack_i32
from .aside import ASIDE, ASIDE_INTS, settle_aside
from .counters import BOX_TESTS, NODES, add_counters, count, private_counters
from .lighttable import ALL_GROUPS, STRATA, light_table
from .shaftleaf import WORK, trace_block
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
    bound_receivers,
    coherent_part,
    load_receivers,
    move_light,
    sets_of,
    tile_at,
    tile_shape,
    write_bits,
)

_STACK = 4 * MAX_DEPTH
_LANES = 12 * 16
_F = np.float32
MAX_TILES = 16
_SCRATCH = MAX_TILES * TILE_FLOATS
_FINISHED = MAX_TILES
_VALID = 2 * MAX_TILES


class Bundle(NamedTuple):
    """How the 16 lanes of a bundle share its tiles and strata."""

    tiles: int  # 1 to 16, a power of two
    groups: int  # groups of strata of each tile: lanes are tile * groups + group
    strata: int  # strata in a group
    count: int  # samples of this chunk


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
    at: object  # int32: link, mask and stack height where a walk goes on
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
def _leaf(tree, code, mask, table, chunk, fixed, bundle, facing, scratch, counters):
    """A block against the lanes in `mask`; bits of the lanes that have no segment left."""
    block, triangles, done = code >> 5, code & 31, np.int64(0)
    all_groups = (np.int64(1) << bundle.groups) - 1
    for g in range(bundle.tiles):
        groups = mask >> (g * bundle.groups) & all_groups
        if groups != 0:
            tile = tile_at(scratch.tiles, g, table, chunk, fixed)
            valid, finished = np.int64(get(scratch.valid, g)), np.int64(get(scratch.valid, _FINISHED + g))
            strata = _lane_strata(groups, bundle) & ~finished
            now = trace_block(
                tile, tree, block, triangles, strata, valid, facing, scratch.work, scratch.aside, counters
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
def _walk(tree, alive, table, chunk, fixed, bundle, facing, scratch, counters):
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
    link, mask, height = np.int64(get(scratch.at, 0)), np.int64(get(scratch.at, 1)) & alive, np.int64(get(scratch.at, 2))
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
        if np.int64(get(scratch.aside, 0)) > ASIDE // 2:
            put(scratch.at, 0, link)
            put(scratch.at, 1, mask)
            put(scratch.at, 2, height)
            return alive
        if ~link & 31 != 0:
            alive &= ~_leaf(tree, ~link, mask, table, chunk, fixed, bundle, facing, scratch, counters)
        mask = np.int64(0)


@inlined
def _trace_lanes(tree, alive, table, chunk, fixed, bundle, facing, scratch, counters):
    """Trace the lanes in `alive`, and settle what is put aside whenever the memory for it runs low, and at the end."""
    put(scratch.at, 0, 0)
    put(scratch.at, 1, alive)
    put(scratch.at, 2, 0)
    put(scratch.aside, 0, 0)
    while alive != 0:
        alive = _walk(tree, alive, table, chunk, fixed, bundle, facing, scratch, counters)
        finished = ptr_at(scratch.valid, _FINISHED)
        settle_aside(tree.corners, scratch.tiles, finished, table, chunk, fixed, facing, scratch.aside, counters)


@inlined
def _start_tile(query, y0, x0, shape, chunk, fixed, bundle, g, tile, valid, scratch, counters):
    """Prepare tile g of a bundle; bits of its lanes that have a segment to trace."""
    put(scratch.valid, g, valid)
    if valid == 0:
        return np.int64(0)
    bound_receivers(tile, valid)
    if not fixed:
        move_light(query, y0, x0, shape, chunk, valid, tile, bundle.count)
    make_shafts(tile.info, tile.groups, tile.shafts)
    apply_horizon(query, y0, x0, shape, valid, bundle.count, tile, scratch.planes, counters)
    finished = np.int64(0)
    for s in range(16):
        if s >= bundle.count or np.int64(get(tile.dead, s)) & valid == valid:
            finished |= np.int64(1) << s
    put(scratch.valid, _FINISHED + g, finished)
    _fill_lanes(g, tile, bundle, scratch.lanes)
    groups = ((np.int64(1) << bundle.groups) - 1) & ~_finished_groups(finished, bundle)
    return groups << (g * bundle.groups)


@inlined
def _light_size(query, tile):
    """A small part of the sum of the light's extents, 0 for a light that moves."""
    if query.light.kind != FIXED:
        return _F(0.0)
    size = _F(0.0)
    for k in range(3):
        size += get(tile.groups, (3 + k) * ALL_GROUPS + 1) - get(tile.groups, k * ALL_GROUPS + 1)
    return _F(2.0**-6) * size


@inlined
def _finish_tile(y0, x0, shape, chunk, bundle, g, tile, scratch, out):
    valid = np.int64(get(scratch.valid, g))
    if valid != 0:
        finished = np.int64(get(scratch.valid, _FINISHED + g))
        write_bits(y0, x0, shape, valid, bundle.count, chunk, tile, finished, out)


@kernel
def _trace_bundles(ticket, arrays, query, table, shape, layout, bundle, alone, chunk, out, counters):
    """Worker: bundles of tiles."""
    scratch = Scratch(
        stack_f32(_SCRATCH), stack_f32(_LANES), stack_f32(WORK), stack_i32(_STACK), stack_i32(_VALID), stack_f32(128),
        stack_i32(4), stack_i32(ASIDE_INTS),
    )  # fmt: skip
    single = Layout(1, 1, layout.columns, layout.rows)
    tree, mine, fixed = block_pointers(arrays), private_counters(counters), query.light.kind == FIXED
    at = take(ticket)
    while at >= 0:
        by, bx = at // layout.columns * layout.down, at % layout.columns * layout.across
        alive, apart = np.int64(0), np.int64(0)
        for g in range(bundle.tiles):
            y0, x0 = (by + g // layout.across) * shape.height, (bx + g % layout.across) * shape.width
            tile = tile_at(scratch.tiles, g, table, chunk, fixed)
            valid = load_receivers(query, y0, x0, shape, tile)
            if valid != coherent_part(tile, valid, _light_size(query, tile)):
                apart |= np.int64(1) << g
                valid = np.int64(0)
            alive |= _start_tile(query, y0, x0, shape, chunk, fixed, bundle, g, tile, valid, scratch, mine)
        home_y, home_x = by, bx
        job, origin, left = bundle, layout, np.int64(0)
        while True:
            _trace_lanes(tree, alive, table, chunk, fixed, job, query.cull_faces, scratch, mine)
            for g in range(job.tiles):
                tile = tile_at(scratch.tiles, g, table, chunk, fixed)
                y0, x0 = (by + g // origin.across) * shape.height, (bx + g % origin.across) * shape.width
                _finish_tile(y0, x0, shape, chunk, job, g, tile, scratch, out)
            if left == 0:  # the next tile whose receivers lie in several places: trace them place by place
                if apart == 0:
                    break
                g = lowest_bit(apart)
                apart &= apart - 1
                by, bx = home_y + g // layout.across, home_x + g % layout.across
                left = np.int64(0xFFFF)
            job, origin = alone, single
            for other in range(1, alone.tiles):  # few samples: the bundle has room for more tiles than the one
                put(scratch.valid, other, 0)
            tile = tile_at(scratch.tiles, 0, table, chunk, fixed)
            y0, x0 = by * shape.height, bx * shape.width
            left &= load_receivers(query, y0, x0, shape, tile)
            part = coherent_part(tile, left, _light_size(query, tile))
            left &= ~part
            alive = _start_tile(query, y0, x0, shape, chunk, fixed, alone, 0, tile, part, scratch, mine)
        at = take(ticket)
    add_counters(counters, mine)


def _bundle(count: int, tiles: int) -> Bundle:
    """The bundle for `count` samples that holds `tiles` tiles, more if there are fewer than 16 strata."""
    strata = 1 << (count - 1).bit_length()
    tiles = max(tiles, STRATA // strata)
    return Bundle(tiles, STRATA // tiles, strata * tiles // STRATA, count)


def _layout(shape: TileShape, tiles: int) -> Layout:
    across = tiles if shape.height == 1 else 1 << (tiles.bit_length() // 2)
    down = tiles // across
    return Layout(across, down, -(-shape.columns // across), -(-shape.rows // down))


TILES = 4


def trace_shadow(tree, query, bits, threads=None, counters=None, progress=None) -> None:
    """Answer a ShadowQuery: set bit s of ``bits[y, x]`` where sample s is occluded.

    tree : BlockTree
    bits : (h, w, ceil(spp / 64)) uint64, zeros on entry
    counters : from `new_counters`, or None
    """
    shape, spp = tile_shape(query), query.samples.shape[1]
    table = light_table(query, sets_of(shape))
    for chunk in range(-(-spp // STRATA)):
        bundle = _bundle(min(STRATA, spp - chunk * STRATA), TILES)
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
            _bundle(bundle.count, 1),
            chunk,
            bits,
            counters,
            progress=progress,
        )
