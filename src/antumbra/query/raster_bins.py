"""Lists of triangles for each tile of the screen."""

from typing import NamedTuple

import numpy as np

from ..kernels.jit import inlined, kernel
from ..kernels.parallel import CHUNK, items, new_ticket, run, shares
from ..kernels.simd import as_i32, get, lowest_bit, ptr, put, stack_f32, stack_i32, stack_i64
from .raster_cull import BLOCK, careful_box, make_padding, quick_boxes, transpose
from .raster_setup import TILE, RasterView

_LEAST_CHUNK, _MOST_CHUNKS = 16 * BLOCK, 256  # of triangles; as many chunks as keep many threads busy
_MOST_COUNTS = 1 << 22  # of the table (chunks, tiles)
_BOXES, _LANES = 4 * BLOCK, 9 * BLOCK
_BUCKETS = 128  # of depth
_BOUNDS = _BUCKETS + 1
_INFINITY = 0x7F800000  # the bits of float32's infinity


class Survivors(NamedTuple):
    """The triangles left by culling. Only slots in `TileBins.slot` are filled; other memory pages stay untouched."""

    triangle: np.ndarray  # (n,) int32
    box: np.ndarray  # (n, 4) int16: first and last pixel, x0, y0, x1, y1
    nearest: np.ndarray  # (n,) float32: upper bound of the triangle's depth key 1 / t


class TileBins(NamedTuple):
    """The candidate triangles of each tile. Tile k owns slot[first[k]:first[k + 1]], in ascending triangle order."""

    seen: Survivors
    first: np.ndarray  # (tiles + 1,) int64
    slot: np.ndarray  # (pairs,) int32: index into the arrays of `seen`


def tiles_across(pixels: int) -> int:
    """Number of tiles along an edge of `pixels` pixels."""
    return -(-pixels // TILE)


@inlined
def _keep(seen, slot, i, box, nearest, columns, counts):
    """Write a triangle to its slot and count it in its tiles, unless its box is empty; return the next slot."""
    x0, y0, x1, y1 = box
    if x0 > x1 or y0 > y1:
        return slot
    seen.triangle[slot], seen.nearest[slot] = i, nearest
    seen.box[slot, 0], seen.box[slot, 1], seen.box[slot, 2], seen.box[slot, 3] = x0, y0, x1, y1
    for row in range(y0 // TILE, y1 // TILE + 1):
        for column in range(x0 // TILE, x1 // TILE + 1):
            counts[row * columns + column] += 1
    return slot + 1


@inlined
def _quick_box(boxes, k):
    return (
        np.int64(get(boxes, k)),
        np.int64(get(boxes, k + BLOCK)),
        np.int64(get(boxes, k + 2 * BLOCK)),
        np.int64(get(boxes, k + 3 * BLOCK)),
    )


@kernel
def _cull(ticket, corners, view, padding, columns, seen, left, counts):
    """Worker: bound all triangles; chunk k keeps left[k] of them, and has counts[k] of them in each tile."""
    p = ptr(corners)
    lanes, boxes, nearest = stack_f32(_LANES), stack_i32(_BOXES), stack_f32(BLOCK)
    for first, end in shares(ticket):
        chunk, slot = first // ticket[CHUNK], first
        row = counts[chunk]
        row[:] = 0
        for block in range(first, end, BLOCK):
            n = min(BLOCK, end - block)
            transpose(p, block, n, lanes)
            for k in range(0, n, 8):
                sure, careful = quick_boxes(view, padding, lanes, k, boxes, nearest)
                todo = (sure | careful) & ((1 << min(8, n - k)) - 1)
                while todo != 0:
                    lane = lowest_bit(todo)
                    todo &= todo - 1
                    i, box, key = block + k + lane, _quick_box(boxes, k + lane), get(nearest, k + lane)
                    if (careful >> lane) & 1 != 0:
                        box, key = careful_box(view, padding, p, i), np.float32(np.inf)
                    slot = _keep(seen, slot, i, box, key, columns, row)
        left[chunk] = slot - first


@kernel
def _prefix_sums(counts, first):
    """Replace counts[chunk, tile] by the start of the chunk's part of a tile's list; first[tile]: start of the list."""
    chunks, tiles = counts.shape
    for chunk in range(chunks):
        for tile in range(tiles):
            first[tile + 1] += counts[chunk, tile]
    for tile in range(tiles):
        first[tile + 1] += first[tile]
    for chunk in range(chunks):  # moves each start to the end of its list, the start of the next ...
        for tile in range(tiles):
            n = counts[chunk, tile]
            counts[chunk, tile] = first[tile]
            first[tile] += n
    for tile in range(tiles, 0, -1):  # ... so shift the starts back
        first[tile] = first[tile - 1]
    first[0] = 0


@kernel
def _fill(ticket, size, columns, left, cursors, box, slots):
    """Worker: write the tiles' lists, chunk by chunk of `size` triangles."""
    for chunk in items(ticket):
        for slot in range(chunk * size, chunk * size + left[chunk]):
            for row in range(box[slot, 1] // TILE, box[slot, 3] // TILE + 1):
                for column in range(box[slot, 0] // TILE, box[slot, 2] // TILE + 1):
                    tile = row * columns + column
                    slots[cursors[chunk, tile]] = slot
                    cursors[chunk, tile] += 1


def bin_triangles(corners, view: RasterView, threads: int) -> TileBins:
    """Cull the triangles, (n, 9) float32, and list the remaining ones by tile."""
    n, columns = len(corners), tiles_across(view.width)
    tiles = columns * tiles_across(view.height)
    size = max(_LEAST_CHUNK, -(-n // max(1, min(_MOST_CHUNKS, _MOST_COUNTS // tiles))))
    chunks = -(-n // size)
    seen = Survivors(np.empty(n, np.int32), np.empty((n, 4), np.int16), np.empty(n, np.float32))
    left, counts = np.empty(chunks, np.int64), np.empty((chunks, tiles), np.int64)
    run(_cull, threads, new_ticket(n, size), corners, view, make_padding(view), columns, seen, left, counts)
    first = np.zeros(tiles + 1, np.int64)
    _prefix_sums(counts, first)
    slots = np.empty(first[-1], np.int32)
    run(_fill, threads, new_ticket(chunks, 1), size, columns, left, counts, seen.box, slots)
    return TileBins(seen, first, slots)


@inlined
def _bucket(key, slot, highest, shift):
    """A larger depth key gives a lower bucket; positive floats sort like their bit patterns."""
    return max(highest - np.int64(get(key, slot)), 0) >> shift


@kernel
def front_to_back(bins, tile, order):
    """Write a tile's slots to `order`, roughly by falling depth key of the nearest corner; return their number."""
    first, n = bins.first[tile], bins.first[tile + 1] - bins.first[tile]
    key, slots, start = as_i32(ptr(bins.seen.nearest)), ptr(bins.slot), stack_i64(_BOUNDS)
    lowest, highest = np.int64(_INFINITY), np.int64(0)
    for e in range(first, first + n):
        k = np.int64(get(key, np.int64(get(slots, e))))
        lowest = k if k < lowest else lowest
        highest = k if highest < k < _INFINITY else highest  # triangles that cross the camera's plane go to bucket 0
    shift = 0
    while (highest - lowest) >> shift >= _BUCKETS:
        shift += 1
    for b in range(_BOUNDS):
        put(start, b, 0)
    for e in range(first, first + n):
        b = _bucket(key, np.int64(get(slots, e)), highest, shift) + 1
        put(start, b, get(start, b) + 1)
    for b in range(_BUCKETS):
        put(start, b + 1, get(start, b + 1) + get(start, b))
    for e in range(first, first + n):
        slot = np.int64(get(slots, e))
        b = _bucket(key, slot, highest, shift)
        order[get(start, b)] = slot
        put(start, b, get(start, b) + 1)
    return n
