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
    bits,
    get,
    iota16,
    load16,
    lowest_bit,
    maximum,
    minimum,
    popcount,
    ptr_at,
    put,
    reduce_max,
    reduce_min,
    splat16,
    stack_i32,
)
from ..tile import coherent_part, load_receivers, tile_at
from .region import MAX_TILES, tile_in

_F = np.float32
REGIONS = 4  # in an area, at most
_MOST = 2 * REGIONS * MAX_TILES  # parts in the list; if an area has more, they come in later lists
_ROW = _MOST + 16  # room for a vector that reaches beyond the last part
_FEW = 4  # parts whose order does not matter
_LEFT, _TILES, _LANES, _ORDER, _SORTED, _KEYS, _PLACES = (i * _ROW for i in (0, 1, 2, 3, 4, 5, 8))
PARTS_INTS = 11 * _ROW


class Parts(NamedTuple):
    """Pointers to an area's parts in PARTS_INTS int32."""

    left: I32Ptr  # int32, one a tile: bits of the receivers that are in no list yet
    tiles: I32Ptr  # int32, one a part: its tile
    lanes: I32Ptr  # int32, one a part: bits of its receivers
    order: I32Ptr  # int32: the parts in the order to trace them
    sorted: I32Ptr  # int32: a piece of `order`, while it is sorted
    keys: F32Ptr  # float32, rows x, y, z: the places of the parts in this piece
    places: F32Ptr  # float32, rows x, y, z: one receiver of each part


@inlined
def parts_at(memory):
    """The `Parts` in PARTS_INTS int32."""
    return Parts(
        ptr_at(memory, _LEFT), ptr_at(memory, _TILES), ptr_at(memory, _LANES), ptr_at(memory, _ORDER),
        ptr_at(memory, _SORTED), as_f32(ptr_at(memory, _KEYS)), as_f32(ptr_at(memory, _PLACES)),
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


@kernel
def list_parts(chunk, layout, y, x, n_tiles, tile, parts):
    """List parts of an area's tiles: receivers near each other. Return their number, 0 once all have been listed.

    tile : `Tile` whose memory is used
    """
    n = np.int64(0)
    for g in range(n_tiles):
        rest = np.int64(get(parts.left, g))
        if rest != 0 and n < _MOST:
            y0, x0 = _place_in(chunk, layout, y, x, g)
            rest &= load_receivers(chunk, y0, x0, tile)
            while rest != 0 and n < _MOST:
                part = coherent_part(tile, rest, chunk.light)
                put(parts.tiles, n, g)
                put(parts.lanes, n, part)
                for k in range(3):
                    put(parts.places, k * _ROW + n, get(tile.origins, 16 * k + lowest_bit(part)))
                rest &= ~part
                n += 1
            put(parts.left, g, rest)
    return n


@inlined
def _longest_axis(parts, first, count):
    """Copy the places of a piece of `order` to `keys`. Return the axis along which they are farthest apart."""
    longest, axis = _F(-1.0), np.int64(0)
    for k in range(3):
        row, at = k * _ROW, np.int64(0)
        for i in range(count):
            put(parts.keys, row + i, get(parts.places, row + np.int64(get(parts.order, first + i))))
        for i in range(count, count + 16):  # of the last vector
            put(parts.keys, row + i, get(parts.keys, row))
        low = high = load16(parts.keys, row)
        while at < count:
            low, high = minimum(low, load16(parts.keys, row + at)), maximum(high, load16(parts.keys, row + at))
            at += 16
        extent = reduce_max(high) - reduce_min(low)
        if extent > longest:
            longest, axis = extent, np.int64(k)
    return axis


@inlined
def _rank(keys, i, count):
    """The number of keys before key i; of equal ones the first comes first."""
    key, rank, at = splat16(get(keys, i)), np.int64(0), np.int64(0)
    while at < count:
        others, index = load16(keys, at), iota16() + splat16(np.int32(at))
        before = (others < key) | ((others == key) & (index < splat16(np.int32(i))))
        rank += popcount(bits(before & (index < splat16(np.int32(count)))))
        at += 16
    return rank


@kernel
def _sort_piece(parts, first, count):
    """Sort a piece of `order` along the axis along which its parts are farthest apart."""
    keys = ptr_at(parts.keys, _longest_axis(parts, first, count) * _ROW)
    for i in range(count):
        put(parts.sorted, _rank(keys, i, count), get(parts.order, first + i))
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
        y0, x0 = _place_in(chunk, layout, y, x, np.int64(get(parts.tiles, k)))
        load_receivers(chunk, y0, x0, tile_at(scratch.tiles, g, chunk))
        put(scratch.valid, g, get(parts.lanes, k))
        put(scratch.places, 2 * g, y0)
        put(scratch.places, 2 * g + 1, x0)
