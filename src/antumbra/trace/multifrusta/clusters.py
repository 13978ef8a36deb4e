"""An area's tiles, cut into coherent parts, in an order in which neighbours lie near each other.

Neighbours in a picture may lie far apart: at silhouettes, and on surfaces seen at a small angle. Sixteen parts that
follow one another in the order are a *cluster*. A cluster is traced together.
"""

from typing import NamedTuple

import numpy as np

from ...kernels.fields import F32Ptr, I32Ptr
from ...kernels.jit import inlined, kernel
from ...kernels.simd import (
    as_f32,
    as_i32,
    broadcast16,
    gather,
    get,
    iota16,
    load16,
    lowest_bit,
    maximum,
    minimum,
    ptr_at,
    put,
    reduce_max,
    reduce_min,
    select,
    splat16,
    stack_i32,
    store,
)
from ...kernels.vec import keep, rows
from ..tile import Tile, coherent_part, fetch_receivers, load_receivers, tile_at
from .region import MAX_TILES, tile_in

_F = np.float32
REGIONS = 4  # in an area, at most
_MOST = 2 * REGIONS * MAX_TILES  # parts in the list; if an area has more, they come in later lists
_ROW = _MOST + 16  # room for a vector that reaches beyond the last part
_AHEAD = 8  # tiles by which receivers are prefetched
_FEW = 4  # parts whose order does not matter
_LEFT, _TILES, _LANES, _ORDER, _SORTED, _KEYS, _RANKS, _PLACES, _RECEIVERS = (i * _ROW for i in (*range(8), 10))
PARTS_INTS = _RECEIVERS + 64 * REGIONS * MAX_TILES
_PLACE_BITS = 255  # at least _MOST - 1


class Parts(NamedTuple):
    """Pointers to an area's parts in PARTS_INTS int32."""

    left: I32Ptr  # int32, one a tile: bits of the receivers that are in no list yet
    tiles: I32Ptr  # int32, one a part: its tile
    lanes: I32Ptr  # int32, one a part: bits of its receivers
    order: I32Ptr  # int32: the parts in the order to trace them
    sorted: I32Ptr  # int32: a piece of `order`, while it is sorted
    keys: I32Ptr  # int32: its keys
    ranks: I32Ptr  # int32: its ranks
    places: F32Ptr  # float32, rows x, y, z: one receiver of each part
    receivers: F32Ptr  # float32, a piece of each tile: x, y, z, and own triangles of its 16 receivers


@inlined
def parts_at(memory):
    """The `Parts` in PARTS_INTS int32."""
    return Parts(
        ptr_at(memory, _LEFT), ptr_at(memory, _TILES), ptr_at(memory, _LANES), ptr_at(memory, _ORDER),
        ptr_at(memory, _SORTED), ptr_at(memory, _KEYS), ptr_at(memory, _RANKS), as_f32(ptr_at(memory, _PLACES)),
        as_f32(ptr_at(memory, _RECEIVERS)),
    )  # fmt: skip


@inlined
def expect(parts, n_tiles, receivers):
    """Note that some receivers (bits) of each tile are to be listed."""
    for g in range(n_tiles):
        put(parts.left, g, np.int32(receivers))


@inlined
def _place_in(chunk, layout, y, x, g):
    """(y, x) of the first pixel of tile g of the area whose first tile is (y, x)."""
    row, column = tile_in(layout, g)
    return (y + row) * chunk.shape.height, (x + column) * chunk.shape.width


@inlined
def _tile_of(parts, g, t):
    """`Tile` t with the receivers of tile g of the area."""
    own = ptr_at(parts.receivers, 64 * g)
    return Tile(
        t.number, own, t.info, as_i32(ptr_at(own, 48)), t.dead, t.shafts, t.beams, t.points, t.groups, t.targets,
        t.by_lane, t.inverses,
    )  # fmt: skip


@kernel
def list_parts(chunk, layout, y, x, n_tiles, tile, parts):
    """List parts of an area's tiles: receivers near each other. Return their number, 0 once all have been listed.

    tile : any `Tile`
    """
    n = np.int64(0)
    for g in range(n_tiles):
        fetch_receivers(chunk, *_place_in(chunk, layout, y, x, g + _AHEAD))
        rest = np.int64(get(parts.left, g))
        if rest != 0 and n < _MOST:
            y0, x0 = _place_in(chunk, layout, y, x, g)
            receivers = _tile_of(parts, g, tile)
            rest &= load_receivers(chunk, y0, x0, receivers)
            while rest != 0 and n < _MOST:
                part = coherent_part(receivers, rest, chunk.light)
                put(parts.tiles, n, g)
                put(parts.lanes, n, part)
                for k in range(3):
                    put(parts.places, k * _ROW + n, get(receivers.origins, 16 * k + lowest_bit(part)))
                rest &= ~part
                n += 1
            put(parts.left, g, rest)
    return n


@inlined
def _extent(parts, k, first, count):
    """(the least coordinate k of a piece of `order`, its extent)."""
    low = high = gather(parts.places, splat16(np.int32(k * _ROW)) + broadcast16(parts.order, first))
    for at in range(0, count, 16):
        x = gather(parts.places, _chosen(parts, first, at, count) + splat16(np.int32(k * _ROW)))
        low, high = minimum(low, x), maximum(high, x)
    low = reduce_min(low)
    return low, reduce_max(high) - low


@inlined
def _chosen(parts, first, at, count):
    """16 parts of a piece of `order`, from place `at` on. Lanes beyond its end repeat the first part."""
    there = iota16() + splat16(np.int32(at)) < splat16(np.int32(count))
    return select(there, load16(parts.order, first + at), broadcast16(parts.order, first))


@kernel
def _sort_piece(parts, first, count):
    """Sort a piece of `order` along the axis along which its parts are farthest apart.

    Keys are the bits of distances from the lowest part. They sort like the distances, and end in their place: so no two
    are equal.
    """
    x, dx = _extent(parts, 0, first, count)
    y, dy = _extent(parts, 1, first, count)
    z, dz = _extent(parts, 2, first, count)
    low, row = (x, 0) if dx >= dy and dx >= dz else ((y, _ROW) if dy >= dz else (z, 2 * _ROW))
    for at in range(0, count, 16):
        place = gather(parts.places, _chosen(parts, first, at, count) + splat16(np.int32(row)))
        store(as_f32(parts.keys), at, place - splat16(low))
        key = load16(parts.keys, at) & splat16(np.int32(~_PLACE_BITS))
        store(parts.keys, at, key | (iota16() + splat16(np.int32(at))))
    for at in range(0, count, 16):
        key, rank = load16(parts.keys, at), splat16(np.int32(0))
        for i in range(count):
            rank = rank + select(broadcast16(parts.keys, i) < key, splat16(np.int32(1)), splat16(np.int32(0)))
        store(parts.ranks, at, rank)
    for i in range(count):
        put(parts.sorted, np.int64(get(parts.ranks, i)), get(parts.order, first + i))
    for i in range(count):
        put(parts.order, first + i, get(parts.sorted, i))


@inlined
def _half(count):
    """About half of a number of parts: full clusters if there are more than one, else full bundles."""
    unit = MAX_TILES if count > MAX_TILES else (8 if count > 8 else _FEW)
    return (count + unit) // (2 * unit) * unit


@kernel
def order_parts(parts, n):
    """Put n listed parts in order, by halving them along the longest axis again and again."""
    waiting, height, first, count = stack_i32(2 * 16), np.int64(0), np.int64(0), np.int64(n)
    for i in range(n):
        put(parts.order, i, np.int32(i))
    while True:
        while count > _FEW:
            half = _half(count)
            _sort_piece(parts, first, count)
            put(waiting, height, np.int32(first + half))
            put(waiting, height + 1, np.int32(count - half))
            height += 2
            count = half
        if height == 0:
            return
        height -= 2
        first, count = np.int64(get(waiting, height)), np.int64(get(waiting, height + 1))


@kernel
def load_cluster(chunk, layout, y, x, first, n, scratch):
    """Load n parts, the first one at `first` in the order, as tiles 0 to n - 1 of a bundle."""
    parts = parts_at(scratch.parts)
    for g in range(n):
        k = np.int64(get(parts.order, first + g))
        number, tile = np.int64(get(parts.tiles, k)), tile_at(scratch.tiles, g, chunk)
        own, (y0, x0) = ptr_at(parts.receivers, 64 * number), _place_in(chunk, layout, y, x, number)
        keep(tile.origins, 0, 16, rows(own, 0, 16))
        store(tile.faces, 0, load16(as_i32(own), 48))
        put(scratch.valid, g, get(parts.lanes, k))
        put(scratch.places, 2 * g, y0)
        put(scratch.places, 2 * g + 1, x0)
