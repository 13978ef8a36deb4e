"""Lists of triangles for each tile of the screen."""

from typing import NamedTuple

import numpy as np

from ..jit import kernel
from ..parallel import CHUNK, N, new_ticket, run, take
from ..simd import get, lowest_bit, ptr, stack_f32, stack_i32
from .raster_cull import BLOCK, careful_box, make_padding, quick_boxes, transpose
from .raster_setup import TILE, View

_LEAST_CHUNK = 16 * BLOCK  # triangles
_MOST_CHUNKS = 256
_MOST_COUNTS = 1 << 22  # of the table (chunks, tiles)
_BOXES, _LANES = 4 * BLOCK, 9 * BLOCK


class Seen(NamedTuple):
    """The triangles that culling leaves. Only slots named by `Bins.slot` are filled, the others' pages never touched."""

    triangle: np.ndarray  # (n,) int32
    box: np.ndarray  # (n, 4) int16: first and last pixel, x0, y0, x1, y1
    nearest: np.ndarray  # (n,) float32: its depth key 1 / t is nowhere larger


class Bins(NamedTuple):
    """What each tile may see. Tile k owns slot[first[k]:first[k + 1]], triangles in ascending order."""

    seen: Seen
    first: np.ndarray  # (tiles + 1,) int64
    slot: np.ndarray  # (pairs,) int32: index into the arrays of `seen`


@kernel
def _keep(seen, slot, i, x0, y0, x1, y1, nearest, columns, counts):
    """Write a triangle to its slot and count it in its tiles; the next slot."""
    seen.triangle[slot], seen.nearest[slot] = i, nearest
    seen.box[slot, 0], seen.box[slot, 1], seen.box[slot, 2], seen.box[slot, 3] = x0, y0, x1, y1
    for row in range(y0 // TILE, y1 // TILE + 1):
        for column in range(x0 // TILE, x1 // TILE + 1):
            counts[row * columns + column] += 1
    return slot + 1


@kernel
def _cull(ticket, corners, view, padding, seen, left, counts):
    """Bound all triangles; chunk k keeps left[k] of them, and has counts[k] of them in each tile."""
    columns, p = (view.width + TILE - 1) // TILE, ptr(corners)
    lanes, boxes, nearest = stack_f32(_LANES), stack_i32(_BOXES), stack_f32(BLOCK)
    first = take(ticket)
    while first >= 0:
        chunk, slot, end = first // ticket[CHUNK], first, min(first + ticket[CHUNK], ticket[N])
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
                    m = k + lane
                    x0, y0 = np.int64(get(boxes, m)), np.int64(get(boxes, m + BLOCK))
                    x1, y1 = np.int64(get(boxes, m + 2 * BLOCK)), np.int64(get(boxes, m + 3 * BLOCK))
                    key = get(nearest, m)
                    if (careful >> lane) & 1 != 0:
                        x0, y0, x1, y1 = careful_box(view, padding, p, block + m)
                        key = np.float32(np.inf)
                    if x0 <= x1 and y0 <= y1:
                        slot = _keep(seen, slot, block + m, x0, y0, x1, y1, key, columns, row)
        left[chunk] = slot - first
        first = take(ticket)


@kernel
def _prefix_sums(counts, first):
    """counts becomes where each chunk's part of each tile's list starts; first, where each list does."""
    for chunk in range(counts.shape[0]):
        for tile in range(counts.shape[1]):
            first[tile + 1] += counts[chunk, tile]
    for tile in range(counts.shape[1]):
        first[tile + 1] += first[tile]
    cursor = first.copy()
    for chunk in range(counts.shape[0]):
        for tile in range(counts.shape[1]):
            n = counts[chunk, tile]
            counts[chunk, tile] = cursor[tile]
            cursor[tile] += n


@kernel
def _fill(ticket, chunk_size, width, left, counts, box, slots):
    """Write the tiles' lists, chunk by chunk."""
    columns = (width + TILE - 1) // TILE
    chunk = take(ticket)
    while chunk >= 0:
        for slot in range(chunk * chunk_size, chunk * chunk_size + left[chunk]):
            for row in range(box[slot, 1] // TILE, box[slot, 3] // TILE + 1):
                for column in range(box[slot, 0] // TILE, box[slot, 2] // TILE + 1):
                    tile = row * columns + column
                    slots[counts[chunk, tile]] = slot
                    counts[chunk, tile] += 1
        chunk = take(ticket)


def bin_triangles(corners, view: View, threads: int) -> Bins:
    """Cull the triangles ((n, 9) float32) and list the rest by tile."""
    n, tiles = len(corners), -(-view.width // TILE) * -(-view.height // TILE)
    size = max(_LEAST_CHUNK, -(-n // max(1, min(_MOST_CHUNKS, _MOST_COUNTS // tiles))))
    chunks = -(-n // size)
    seen = Seen(np.empty(n, np.int32), np.empty((n, 4), np.int16), np.empty(n, np.float32))
    left, counts = np.empty(chunks, np.int64), np.empty((chunks, tiles), np.int64)
    run(_cull, threads, new_ticket(n, size), corners, view, make_padding(view), seen, left, counts)
    first = np.zeros(tiles + 1, np.int64)
    _prefix_sums(counts, first)
    slots = np.empty(first[-1], np.int32)
    run(_fill, threads, new_ticket(chunks, 1), size, view.width, left, counts, seen.box, slots)
    return Bins(seen, first, slots)
