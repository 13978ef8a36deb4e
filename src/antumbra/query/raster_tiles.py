"""Tiles of the screen: edge functions and depth keys of eight pixels at a time, the exact predicate where they cannot say.

A tile keeps, for each pixel, its face and an interval that surely holds the face's depth key 1 / t. A triangle wins a
pixel at once when it surely covers it and its interval lies above the pixel's; it loses at once when it surely misses or
its interval lies below. Anything else goes to `filters.meets` and `filters.hit_t`, as every pixel would in the contract.
"""

from typing import NamedTuple

import numpy as np

from ..jit import kernel
from ..parallel import take
from ..predicate.exact import ray_along
from ..predicate.filters import hit_t, meets, plane_side
from ..simd import any_lane, atomic_add, bits, fma, get, iota8, load8, lowest_bit, minimum, ptr, put, select, splat8, store, to_f32
from .pixels import pixel_direction
from .raster_setup import TILE, edge_functions, turned

_F = np.float32
_STRIDE = TILE + 8  # of a tile's rows: vectors may start at any pixel, and run over its right edge
_KEY_ERROR = 2.0**-22  # relative: more than rounding a canonical key to float32 loses
_TINY = 1e-37

PAIRS, BLOCKS, UNCERTAIN = 0, 1, 2


class Tile(NamedTuple):
    """Pointers to the state of a tile: pixel (x, y) of it is element y * _STRIDE + x."""

    low: object  # float32, least possible depth key of the face; -inf where there is none
    high: object  # float32, largest possible one
    face: object  # int32; -1 where there is none
    unsure: object  # int32: pixels that the last triangle leaves to the exact predicate


@kernel
def pixel_ray(rays, x, y):
    """The ray of pixel (x, y), over (0, inf)."""
    dx, dy, dz = pixel_direction(rays, x, y)
    return ray_along(rays.origin[0], rays.origin[1], rays.origin[2], dx, dy, dz, 0.0, np.inf)


@kernel
def _settle(tile, at, ray, corners, i):
    """Put triangle i in a pixel of the tile if the contract says so."""
    if meets(ray, corners, i) == 0:
        return
    t, j = hit_t(ray, corners, i), np.int64(get(tile.face, at))
    if j >= 0:
        other = hit_t(ray, corners, j)
        if other < t or (other == t and j < i):
            return
    key = 1.0 / t
    put(tile.low, at, _F(key * (1.0 - _KEY_ERROR) - _TINY))
    put(tile.high, at, _F(key * (1.0 + _KEY_ERROR) + _TINY))
    put(tile.face, at, i)


@kernel
def _cover(tile, i, columns, rows, at, f):
    """Draw triangle i into the `columns` x `rows` pixels from pixel `at` of the tile; the number of unsure pixels."""
    lanes, count = to_f32(iota8()), 0
    for y in range(rows):
        down = _F(y)
        r0, r1, r2 = f.c0 + f.b0 * down, f.c1 + f.b1 * down, f.c2 + f.b2 * down
        key_row = f.key_c + f.key_b * down
        for x in range(0, columns, 8):
            right = lanes + _F(x)
            inside = minimum(minimum(fma(right, f.a0, r0), fma(right, f.a1, r1)), fma(right, f.a2, r2))
            key = fma(right, f.key_a, key_row)
            key_low, key_high = key - f.key_error, key + f.key_error
            k = at + x
            low = load8(tile.low, k)
            candidate = (inside >= _F(-1.0)) & (key_high >= low)
            if any_lane(candidate):
                high = load8(tile.high, k)
                wins = candidate & (inside > _F(1.0)) & (key_low > high)
                store(tile.low, k, select(wins, key_low, low))
                store(tile.high, k, select(wins, key_high, high))
                store(tile.face, k, select(wins, splat8(i), load8(tile.face, k)))
                unsure = bits(candidate & ~wins)
                while unsure != 0:
                    put(tile.unsure, count, k + lowest_bit(unsure))
                    unsure &= unsure - 1
                    count += 1
        at += _STRIDE
    return count


@kernel
def _settle_all(tile, count, x0, y0, corners, rays, i):
    for u in range(count):
        at = np.int64(get(tile.unsure, u))
        y, x = at // _STRIDE, at % _STRIDE
        if x < TILE:
            _settle(tile, at, pixel_ray(rays, x0 + x, y0 + y), corners, i)


@kernel
def _draw(tile, bins, k, x0, y0, x1, y1, corners, rays, view, cull_faces, counts):
    """Draw the list of tile k, whose pixels are (x0, y0) to (x1, y1)."""
    p = ptr(corners)
    for entry in range(bins.first[k], bins.first[k + 1]):
        slot = np.int64(bins.slot[entry])
        i = np.int64(bins.triangle[slot])
        left, top = max(np.int64(bins.box[slot, 0]), x0), max(np.int64(bins.box[slot, 1]), y0)
        columns = min(np.int64(bins.box[slot, 2]), x1) - left + 1
        rows = min(np.int64(bins.box[slot, 3]), y1) - top + 1
        counts[PAIRS] += 1
        turn, f = edge_functions(view, p, i, left, top, columns + 7, rows)
        if turn == 0:
            turn = -view.turn * plane_side(rays.origin[0], rays.origin[1], rays.origin[2], corners, i)
            if turn < 0:
                f = turned(f)
        if turn * view.turn != cull_faces and turn != 0:
            at = (top - y0) * _STRIDE + left - x0
            unsure = _cover(tile, i, columns, rows, at, f)
            if unsure != 0:
                counts[UNCERTAIN] += unsure
                _settle_all(tile, unsure, x0, y0, corners, rays, i)


@kernel
def _finish(tile, x0, y0, x1, y1, corners, rays, face, t):
    """Write the tile's faces and their canonical t."""
    for y in range(y0, y1 + 1):
        for x in range(x0, x1 + 1):
            i = np.int64(get(tile.face, (y - y0) * _STRIDE + x - x0))
            face[y, x] = i
            t[y, x] = hit_t(pixel_ray(rays, x, y), corners, i) if i >= 0 else np.inf


@kernel
def draw_tiles(ticket, bins, corners, rays, view, cull_faces, face, t, counters):
    """Worker: whole tiles of the picture, each by one thread."""
    n = TILE * _STRIDE
    low, high, nearest, unsure = np.empty(n, np.float32), np.empty(n, np.float32), np.empty(n, np.int32), np.empty(n, np.int32)
    tile = Tile(ptr(low), ptr(high), ptr(nearest), ptr(unsure))
    counts = np.zeros(3, np.int64)
    across = (view.width + TILE - 1) // TILE
    k = take(ticket)
    while k >= 0:
        low[:], high[:], nearest[:] = _F(-np.inf), _F(-np.inf), np.int32(-1)
        y0, x0 = k // across * TILE, k % across * TILE
        y1, x1 = min(y0 + TILE, view.height) - 1, min(x0 + TILE, view.width) - 1
        _draw(tile, bins, k, x0, y0, x1, y1, corners, rays, view, cull_faces, counts)
        _finish(tile, x0, y0, x1, y1, corners, rays, face, t)
        k = take(ticket)
    for c in range(3):
        atomic_add(counters, c, counts[c])
