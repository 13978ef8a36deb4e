"""Areas of 16 tiles, whose rays form frusta of 16 receivers and one light sample; see `sample_frusta`.

Tiles are 4 x 4 pixels, so that lane k of each has sample set k. An area is 4 x 4 tiles, or 16 tiles of a row. Frustum k
has lane k of each tile, or, if all sets have the same samples, all lanes of tile k.
"""

from typing import NamedTuple

import numpy as np

from ...kernels.jit import F32Ptr, I32Ptr, inlined, kernel
from ...kernels.simd import (
    bits,
    broadcast16,
    get,
    load16,
    lowest_bit,
    mask_from_bits16,
    maximum,
    minimum,
    ptr_at,
    put,
    reduce_max,
    reduce_min,
    select,
    splat16,
    store,
)
from ..horizon import apply_horizon
from ..tile import (
    SPLIT,
    bound_receivers,
    load_receivers,
    move_light,
    read_bits,
    tile_at,
    transpose_bits,
)

# --- An area of 16 tiles ----------------------------------------------------------------------------------------------


_F = np.float32
TILES = 16
PARTS = 8  # at most; the last one has all receivers that remain
PART_INTS = 16 * (PARTS + 4)  # memory for the parts, and to find the last one


class FrustaArea(NamedTuple):
    """Pointers to the 16 tiles of an area, and how its rays form frusta."""

    tiles: F32Ptr  # float32, see `tile.tile_at`
    pixels: I32Ptr  # int32, see `tile.first_pixel`
    valid: I32Ptr  # int32: bits of each tile's receivers
    by_tile: bool  # whether a frustum has the receivers of a tile
    shared: bool  # whether the rays of a frustum have a common light sample, from which they then start
    fresh: bool  # whether no segment is known to be blocked yet


class SampleFrusta(NamedTuple):
    """Pointers to 16 frusta of 16 rays; row k is frustum k."""

    starts: F32Ptr  # float32: rows x, y, z of the rays
    ends: F32Ptr  # float32: the same
    faces: I32Ptr  # int32: the receivers' own triangles
    open: I32Ptr  # int32, one per frustum: bits of its unblocked rays in the part that is traced
    bounds: F32Ptr  # float32, see above
    work: F32Ptr  # float32: LANES of a triangle
    shared: bool  # whether the starts of a row are the same


class SampleScratch(NamedTuple):
    """Pointers to the rest of a thread's memory."""

    stack: I32Ptr  # int32
    at: I32Ptr  # int32, see `descent.save`
    words: I32Ptr  # int32, 32: for transpositions
    parts: I32Ptr  # int32, rows of 16: bits of the rays of each frustum in each part
    deferred: I32Ptr  # int32, see `triangle_tests.deferred_ints`


@inlined
def first_pixel_of(chunk, y0, x0, g):
    """(y, x) of the first receiver of tile g."""
    if chunk.shape.height == 1:
        return y0, x0 + 16 * g
    return y0 + 4 * (g >> 2), x0 + 4 * (g & 3)


@kernel
def start_area(chunk, y0, x0, area, scratch, known, counters):
    """Fill the tiles of an area. Return bits of those with receivers.

    known : pointer to the bits of all receivers; ignored if the area is fresh
    """
    there = np.int64(0)
    for g in range(TILES):
        y, x = first_pixel_of(chunk, y0, x0, g)
        put(area.pixels, 2 * g, y)
        put(area.pixels, 2 * g + 1, x)
        tile = tile_at(area.tiles, g, chunk)
        valid = load_receivers(chunk, y, x, tile) if y < chunk.query.h and x < chunk.query.w else 0
        put(area.valid, g, valid)
        if valid != 0:
            there |= np.int64(1) << g
            bound_receivers(tile, valid)
            if not chunk.fixed:
                move_light(chunk, y, x, valid, tile)
            if area.fresh:
                apply_horizon(chunk, y, x, valid, tile, scratch.deferred, counters)
            else:
                read_bits(chunk, y, x, valid, tile, known)
    return there


@inlined
def gather_receivers(area, frusta, chunk, there):
    """Fill the receivers of all frusta, once per area. Missing tiles repeat another one."""
    origins = frusta.ends if area.shared else frusta.starts
    for g in range(TILES):
        tile = tile_at(area.tiles, g if there >> g & 1 else lowest_bit(there), chunk)
        for lane in range(16):
            row, at = (g, lane) if area.by_tile else (lane, g)
            for k in range(3):
                put(origins, 48 * row + 16 * k + at, get(tile.origins, 16 * k + lane))
            put(frusta.faces, 16 * row + at, get(tile.faces, lane))


@inlined
def gather_points(area, frusta, chunk, there, s):
    """Fill the light samples of stratum s."""
    points = frusta.starts if area.shared else frusta.ends
    if area.shared:
        for row in range(16):
            for k in range(3):
                store(points, 48 * row + 16 * k, broadcast16(chunk.points, 48 * s + 16 * k + row))
        return
    for g in range(TILES):
        tile = tile_at(area.tiles, g if there >> g & 1 else lowest_bit(there), chunk)
        for lane in range(16):
            row, at = (g, lane) if area.by_tile else (lane, g)
            for k in range(3):
                put(points, 48 * row + 16 * k + at, get(tile.points, 48 * s + 16 * k + lane))


@kernel
def read_open(area, frusta, chunk, s, part, words):
    """Set the unblocked rays of a part (16 int32) from the tiles. Return bits of the frusta with such rays."""
    for g in range(TILES):
        valid = get(area.valid, g)
        blocked = get(tile_at(area.tiles, g, chunk).dead, s) if valid != 0 else np.int32(0)
        put(words, g, valid & ~blocked)
    if not area.by_tile:
        transpose_bits(words, words)
    store(frusta.open, 0, load16(words, 0) & load16(part, 0))
    return bits(load16(frusta.open, 0) != np.int32(0))


@kernel
def write_blocked(area, frusta, chunk, s, part, words):
    """Set the blocked rays of a part in the tiles."""
    store(words, 0, load16(part, 0) & ~load16(frusta.open, 0))
    if not area.by_tile:
        transpose_bits(words, words)
    for g in range(TILES):
        if get(area.valid, g) != 0:
            dead = tile_at(area.tiles, g, chunk).dead
            put(dead, s, get(dead, s) | get(words, g))


# --- Parts of an area -------------------------------------------------------------------------------------------------
#
# At silhouettes, a frustum spans several surfaces. As in `tile.coherent_part`, the receivers are halved as long as the
# boxes of the halves are clearly smaller in sum.


@inlined
def _extent(origins, masks, k):
    """(lower, upper bound) along axis k of the receivers in `masks` (16 int32)."""
    far = splat16(_F(np.inf))
    low, high = far, -far
    for row in range(16):
        there, o = mask_from_bits16(get(masks, row)), load16(origins, 48 * row + 16 * k)
        low, high = minimum(low, select(there, o, far)), maximum(high, select(there, o, -far))
    return reduce_min(low), reduce_max(high)


@kernel
def _halve(origins, masks, lower):
    """Write the masks of the receivers in the lower half of the box along its longest axis. Return the box's size."""
    size, longest, at, middle = _F(0.0), _F(-1.0), 0, _F(0.0)
    for k in range(3):
        low, high = _extent(origins, masks, k)
        size += high - low
        if high - low > longest:
            longest, at, middle = high - low, k, _F(0.5) * low + _F(0.5) * high
    for row in range(16):
        put(lower, row, bits(load16(origins, 48 * row + 16 * at) <= middle) & get(masks, row))
    return size


@kernel
def _first_part(origins, left, part):
    """Write a part of the receivers `left` to `part`, and remove it from them; 48 int32 follow `part`."""
    store(part, 0, load16(left, 0))
    lower, upper, half = ptr_at(part, 16), ptr_at(part, 32), ptr_at(part, 48)
    while True:
        size = _halve(origins, part, lower)
        store(upper, 0, load16(part, 0) & ~load16(lower, 0))
        if bits(load16(lower, 0) != np.int32(0)) == 0 or bits(load16(upper, 0) != np.int32(0)) == 0:
            break
        if _halve(origins, lower, half) + _halve(origins, upper, half) > SPLIT * size:
            break
        store(part, 0, load16(lower, 0))
    store(left, 0, load16(left, 0) & ~load16(part, 0))


@kernel
def divide_area(area, frusta, scratch):
    """Write the parts of an area's receivers. Return their number."""
    origins, left = frusta.ends if area.shared else frusta.starts, scratch.words
    store(left, 0, load16(area.valid, 0))
    if not area.by_tile:
        transpose_bits(left, left)
    for n in range(PARTS - 1):
        if bits(load16(left, 0) != np.int32(0)) == 0:
            return n
        _first_part(origins, left, ptr_at(scratch.parts, 16 * n))
    store(scratch.parts, 16 * (PARTS - 1), load16(left, 0))
    return PARTS
