"""`multifrusta`: 16 shafts of shadow rays at once through a shallow BVH, rays only where shafts do not decide.

Multi-frusta tracing [Benthin and Wald 2009] for area lights.
"""

from typing import NamedTuple

import numpy as np

from ..bvh.blocks import ROWS, block_pointers
from ..bvh.nodes import MAX_DEPTH
from ..jit import inlined, kernel
from ..parallel import new_ticket, run, take, thread_count
from ..simd import get, load16, lowest_bit, prefetch, ptr, ptr_at, put, stack_f32, stack_i32
from .aside import ASIDE, aside_ints, settle_aside
from .asked import TileShape, asked_of, sets_of, tile_shape
from .beams import make_beams
from .counters import add_counters, private_counters
from .descent import left, next_leaf, root, save, saved, slabs_of
from .lighttable import ALL_GROUPS, STRATA, light_table, turn_points
from .ownsurface import PLANES, apply_horizon
from .packet16 import over_samples
from .scattered import is_scattered
from .shaftleaf import WORK, trace_block
from .shafts import make_shafts
from .slabs import Shafts
from .tile import (
    TILE_FLOATS,
    bound_receivers,
    coherent_part,
    finished_strata,
    first_pixel,
    load_receivers,
    move_light,
    tile_at,
    write_bits,
)

TILES = 4  # of a bundle, as long as they fill its lanes
_MAX_TILES = 16
_STACK = 4 * MAX_DEPTH
_LANES = 12 * 16
_SCRATCH = _MAX_TILES * TILE_FLOATS
_PLACES = 2 * _MAX_TILES
_WAITING = 4
_AT = _WAITING + 2
_ASIDE = aside_ints(TILES)


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

    tiles: object  # float32, _MAX_TILES tiles
    lanes: object  # float32, rows of `Shafts`
    work: object  # float32, for `shaftleaf`
    stack: object  # int32: links and masks
    valid: object  # int32: bits of each tile's receivers
    left: object  # int32: bits of each tile's receivers that are not traced yet
    places: object  # int32: y and x of each tile's first pixel
    planes: object  # float32, for `ownsurface`
    at: object  # int32: where a walk goes on; from _WAITING on, the leaf that waits and its lanes
    aside: object  # int32, see `aside`


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
    """A block against the lanes in `mask`; bits of those that have no segment left."""
    done, all_groups = np.int64(0), (np.int64(1) << bundle.groups) - 1
    for g in range(bundle.tiles):
        groups = mask >> (g * bundle.groups) & all_groups
        if groups != 0:
            tile, valid = tile_at(scratch.tiles, g, asked), np.int64(get(scratch.valid, g))
            strata = _lane_strata(groups, bundle) & ~finished_strata(tile, valid)
            trace_block(
                tile, tree, code >> 5, code & 31, strata, valid, asked.facing, scratch.work, scratch.aside, counters
            )
            done |= (groups & _finished_groups(finished_strata(tile, valid), bundle)) << (g * bundle.groups)
    return done


@inlined
def _finished_groups(strata, bundle):
    """Groups all of whose strata are among the given ones."""
    ones, groups = (np.int64(1) << bundle.strata) - 1, np.int64(0)
    for q in range(bundle.groups):
        if (strata >> (q * bundle.strata)) & ones == ones:
            groups |= np.int64(1) << q
    return groups


@inlined
def _fetch(tree, code):
    """Ask for a block's numbers before they are needed."""
    block = code >> 5
    numbers = ptr_at(tree.blocks, block * (ROWS * 16))
    prefetch(tree.bounds, block * 8)
    for row in range(ROWS):
        prefetch(numbers, row * 16)
    prefetch(tree.slots, block * 16)


@kernel
def _walk(tree, alive, asked, bundle, scratch, counters):
    """Trace the lanes in `alive` through the tree; those left when the memory for what is put aside runs low.

    A block is fetched when it is found, and tested when the next one is.
    """
    slabs, at = slabs_of(_shafts(scratch.lanes), alive), saved(scratch.at, alive)
    code, mask = np.int64(get(scratch.at, _WAITING)), np.int64(get(scratch.at, _WAITING + 1))
    while True:
        at = next_leaf(tree, slabs, at, scratch.stack, alive, counters)
        if at.mask != 0:
            _fetch(tree, ~at.link)
        if mask & alive != 0:
            if np.int64(get(scratch.aside, 0)) > ASIDE:
                save(scratch.at, at)
                put(scratch.at, _WAITING, code)
                put(scratch.at, _WAITING + 1, mask)
                return alive
            alive &= ~_leaf(tree, code, mask & alive, asked, bundle, scratch, counters)
        if at.mask == 0:
            return np.int64(0)
        code, mask = ~at.link, at.mask if ~at.link & 31 != 0 else np.int64(0)
        at = left(at)


@inlined
def _trace_lanes(tree, alive, query, asked, bundle, scratch, counters):
    """Trace the lanes in `alive`, and settle what is put aside whenever the memory for it runs low, and at the end."""
    save(scratch.at, root(alive))
    put(scratch.at, _WAITING, 0)
    put(scratch.at, _WAITING + 1, 0)
    while True:
        if alive != 0:
            alive = _walk(tree, alive, asked, bundle, scratch, counters)
        if np.int64(get(scratch.aside, 0)) != 0:
            settle_aside(tree.corners, query, asked, scratch.tiles, scratch.places, scratch.aside, counters)
        if alive == 0:
            return


@inlined
def _start_tile(query, asked, bundle, g, scratch, counters):
    """Prepare tile g of a bundle, whose receivers are loaded; bits of its lanes that have a segment to trace."""
    tile, valid = tile_at(scratch.tiles, g, asked), np.int64(get(scratch.valid, g))
    y0, x0 = first_pixel(scratch.places, g)
    bound_receivers(tile, valid)
    if not asked.fixed:
        move_light(query, asked, y0, x0, valid, tile)
        turn_points(tile.points, tile.by_lane, asked.count)
    make_shafts(tile.info, tile.groups, tile.shafts)
    make_beams(tile)
    apply_horizon(asked, y0, x0, valid, tile, scratch.planes, scratch.aside, counters)
    _fill_lanes(g, tile, bundle, scratch.lanes)
    groups = ((np.int64(1) << bundle.groups) - 1) & ~_finished_groups(finished_strata(tile, valid), bundle)
    return groups << (g * bundle.groups)


@inlined
def _next_parts(asked, layout, y, x, scratch):
    """Load, of each tile of a bundle, receivers near each other that are not traced yet; how many tiles have any."""
    n = np.int64(0)
    for g in range(layout.across * layout.down):
        rest = np.int64(get(scratch.left, g))
        if rest != 0:
            tile = tile_at(scratch.tiles, n, asked)
            y0, x0 = (y + g // layout.across) * asked.shape.height, (x + g % layout.across) * asked.shape.width
            rest &= load_receivers(asked, y0, x0, tile)
            part = coherent_part(tile, rest, asked.light)
            put(scratch.left, g, rest & ~part)
            put(scratch.valid, n, part)
            put(scratch.places, 2 * n, y0)
            put(scratch.places, 2 * n + 1, x0)
            n += np.int64(part != 0)
    return n


@inlined
def _even_bits(code):
    """Bits 0, 2 and 4 of a number, side by side."""
    return code & 1 | code >> 1 & 2 | code >> 2 & 4


def _squares(layout: Layout) -> int:
    """Runs of 64 bundles: squares of 8 x 8, or of a row."""
    return -(-layout.columns // 64) if layout.rows == 1 else -(-layout.columns // 8) * -(-layout.rows // 8)


@inlined
def _corner_of(layout, at):
    """(row, column) of a bundle's first tile. Squares come row by row, bundles of each in Z order, for the caches."""
    if layout.rows == 1:
        return np.int64(0), at * layout.across
    square, code, across = at >> 6, at & 63, (layout.columns + 7) >> 3
    by, bx = square // across * 8 + _even_bits(code >> 1), square % across * 8 + _even_bits(code)
    return by * layout.down, bx * layout.across


@inlined
def _bundle_of(tiles, count):
    """The `Bundle` of so many tiles, with so many samples."""
    size, strata = np.int64(1), np.int64(1)
    while size < tiles:
        size *= 2
    while strata < count:
        strata *= 2
    groups = STRATA // size if STRATA // size < strata else strata
    return Bundle(size, groups, strata // groups)


@kernel
def _trace_bundles(ticket, arrays, query, table, shape, layout, chunk, n_samples, out, counters):
    """Worker: bundles of tiles; where a tile's receivers lie in several places, one place after the other."""
    scratch = Scratch(
        stack_f32(_SCRATCH), stack_f32(_LANES), stack_f32(WORK), stack_i32(_STACK),
        stack_i32(_MAX_TILES), stack_i32(_MAX_TILES), stack_i32(_PLACES), stack_f32(PLANES),
        stack_i32(_AT), stack_i32(_ASIDE),
    )  # fmt: skip
    tree, mine = block_pointers(arrays), private_counters(counters)
    asked, places = asked_of(query, table, shape, chunk, n_samples), ptr(out)
    put(scratch.aside, 0, 0)
    at = take(ticket)
    while at >= 0:
        y, x = _corner_of(layout, at)
        for g in range(layout.across * layout.down):
            put(scratch.left, g, np.int32(0xFFFF))
        n = _next_parts(asked, layout, y, x, scratch)
        while n > 0:
            bundle, alive = _bundle_of(n, n_samples), np.int64(0)
            for g in range(n):
                alive |= _start_tile(query, asked, bundle, g, scratch, mine)
            _trace_lanes(tree, alive, query, asked, bundle, scratch, mine)
            for g in range(n):
                y0, x0 = first_pixel(scratch.places, g)
                write_bits(asked, y0, x0, np.int64(get(scratch.valid, g)), tile_at(scratch.tiles, g, asked), places)
            n = _next_parts(asked, layout, y, x, scratch)
        at = take(ticket)
    add_counters(counters, mine)


def _layout(shape: TileShape, count: int) -> Layout:
    """Bundles of TILES tiles, or more if it takes more to fill the lanes with `count` samples."""
    tiles = max(TILES, STRATA >> (count - 1).bit_length())
    across = tiles if shape.height == 1 else 1 << (tiles.bit_length() // 2)
    down = tiles // across
    return Layout(across, down, -(-shape.columns // across), -(-shape.rows // down))


def trace_shadow(tree, query, bits, threads=None, counters=None, progress=None) -> None:
    """Answer a ShadowQuery: set bit s of ``bits[y, x]`` where sample s is occluded.

    Samples without order, those of interleaved lists of lights, are left to packets: see `scattered`.

    tree : BlockTree
    bits : (h, w, ceil(spp / 64)) uint64, zeros on entry
    counters : from `new_counters`, or None
    """
    if is_scattered(query):
        over_samples(tree, query, bits, threads, counters, progress)
        return
    shape, spp = tile_shape(query), query.samples.shape[1]
    table = light_table(query, sets_of(shape))
    for chunk in range(-(-spp // STRATA)):
        count = min(STRATA, spp - chunk * STRATA)
        layout = _layout(shape, count)
        run(
            _trace_bundles,
            thread_count(threads),
            new_ticket(_squares(layout) * 64, 1),
            tree,
            query,
            table,
            shape,
            layout,
            chunk,
            count,
            bits,
            counters,
            progress=progress,
        )
