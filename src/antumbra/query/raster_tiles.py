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
from ..simd import (
    any_lane,
    as_i32,
    atomic_add,
    bits,
    fma,
    get,
    iota8,
    load8,
    lowest_bit,
    maximum,
    minimum,
    ptr,
    put,
    select,
    splat8,
    stack_f32,
    stack_i32,
    stack_i64,
    store,
    to_f32,
    to_i32,
)
from .pixels import pixel_direction
from .raster_setup import TILE, edge_functions, turned

_F = np.float32
_STRIDE = TILE + 8  # of a tile's rows: vectors may start at any pixel, and run over its right edge
_CELLS = TILE * _STRIDE
_BUCKETS = 128
_BOUNDS = _BUCKETS + 1
_INFINITY = 0x7F800000  # the bits of float32's infinity
_KEY_ERROR = 2.0**-22  # relative: more than rounding a canonical key to float32 loses
_TINY = 1e-37

PAIRS, BLOCKS, UNCERTAIN = 0, 1, 2


class Tile(NamedTuple):
    """Pointers to the state of a tile: pixel (x, y) of it is element y * _STRIDE + x."""

    low: object  # float32, least possible depth key of the face; -inf where there is none
    high: object  # float32, largest possible one, where there is a face
    face: object  # int32; -1 where there is none
    unsure: object  # int32: pixels that the last triangle leaves to the exact predicate
    ranges: object  # (16,) int32: of eight rows, the first pixel to draw and the one after the last


@kernel
def pixel_ray(rays, x, y):
    """The ray of pixel (x, y), over (0, inf)."""
    dx, dy, dz = pixel_direction(rays, x, y)
    return ray_along(rays.origin[0], rays.origin[1], rays.origin[2], dx, dy, dz, 0.0, np.inf)


class Plane(NamedTuple):
    nx: float
    ny: float
    nz: float
    volume: float
    m: float
    s: float


@kernel
def plane_of(ox, oy, oz, corners, i):
    f = np.float64
    i = max(i, 0)
    x, y, z = f(corners[i, 0]), f(corners[i, 1]), f(corners[i, 2])
    ax, ay, az = (x - f(ox), y - f(oy), z - f(oz))
    px, py, pz = (f(corners[i, 3]) - x, f(corners[i, 4]) - y, f(corners[i, 5]) - z)
    qx, qy, qz = (f(corners[i, 6]) - x, f(corners[i, 7]) - y, f(corners[i, 8]) - z)
    nx, ny, nz = py * qz - pz * qy, pz * qx - px * qz, px * qy - py * qx
    volume = ax * nx + ay * ny + az * nz
    m = max(abs(ax), abs(ay), abs(az))
    s = max(max(abs(px), abs(py), abs(pz)), max(abs(qx), abs(qy), abs(qz)))
    return Plane(nx, ny, nz, volume, m, s)


@kernel
def plane_t(plane, dx, dy, dz):
    f=np.float64
    dx, dy, dz = f(dx), f(dy), f(dz)
    d1 = abs(dx) + abs(dy) + abs(dz)
    det = dx * plane.nx + dy * plane.ny + dz * plane.nz
    m, s = plane.m, plane.s
    u, tiny = 20*2.0**-53, 1e-300
    floor = tiny * (d1 + m + s) + tiny
    if 3*u * m * s * s + floor <= 2.0**-30 * abs(plane.volume) and u * d1 * s * s + floor <= 2.0**-30*abs(det):
        return plane.volume / det
    return -1.0


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
def _clear(tile):
    for k in range(0, _CELLS, 8):
        store(tile.low, k, splat8(_F(-np.inf)))
        store(tile.face, k, splat8(-1))


@kernel
def _clip_rows(a, b, c, y, low, high):
    """Narrow the ranges of pixels of eight rows to where an edge function may be positive."""
    if abs(a) < _F(1e-20):
        return low, high
    # c + b y + 1 loses 4 * 2**-24 of its terms
    pad = _F(0.01) + _F(2.0**-21) * (abs(c) + abs(b) * _F(TILE) + _F(1.0)) / abs(a)
    x = fma(y, b, c + _F(1.0)) * (_F(-1.0) / a)
    if a > _F(0.0):
        return maximum(low, x - pad), high
    return low, minimum(high, x + pad)


@kernel
def _row_ranges(tile, f, y, columns, rows):
    """First and last pixel of rows y to y + 7 that triangle `f` may cover."""
    low, high = splat8(_F(0.0)), splat8(_F(columns - 1))
    if columns * rows > 64:
        down = to_f32(iota8() + y)
        low, high = _clip_rows(f.a0, f.b0, f.c0, down, low, high)
        low, high = _clip_rows(f.a1, f.b1, f.c1, down, low, high)
        low, high = _clip_rows(f.a2, f.b2, f.c2, down, low, high)
    store(tile.ranges, 0, to_i32(minimum(low, _F(TILE))))
    store(tile.ranges, 8, to_i32(maximum(high + _F(1.0), _F(0.0))))


@kernel
def _cover(tile, i, columns, rows, at, f):
    """Draw triangle i into the `columns` x `rows` pixels from pixel `at` of the tile; the number of unsure pixels."""
    lanes, count = to_f32(iota8()), 0
    for y in range(rows):
        if y & 7 == 0:
            _row_ranges(tile, f, y, columns, rows)
        down = _F(y)
        r0, r1, r2 = f.c0 + f.b0 * down, f.c1 + f.b1 * down, f.c2 + f.b2 * down
        key_row = f.key_c + f.key_b * down
        for x in range(np.int64(get(tile.ranges, y & 7)), np.int64(get(tile.ranges, 8 + (y & 7))), 8):
            right = lanes + _F(x)
            inside = minimum(minimum(fma(right, f.a0, r0), fma(right, f.a1, r1)), fma(right, f.a2, r2))
            key = fma(right, f.key_a, key_row)
            key_low, key_high = key - f.key_error, key + f.key_error
            k = at + x
            low = load8(tile.low, k)
            candidate = (inside >= _F(-1.0)) & (key_high >= low)
            if any_lane(candidate):
                high, face = load8(tile.high, k), load8(tile.face, k)
                wins = candidate & (inside > _F(1.0)) & ((face < 0) | (key_low > high))
                store(tile.low, k, select(wins, key_low, low))
                store(tile.high, k, select(wins, key_high, high))
                store(tile.face, k, select(wins, splat8(i), face))
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
def _hidden(tile, at, columns, rows, nearest):
    """Whether every one of the `columns` x `rows` pixels from pixel `at` has a face surely in front of `nearest`."""
    for y in range(rows):
        for x in range(0, columns, 8):
            behind = (load8(tile.low, at + x) <= nearest) & (iota8() < columns - x)
            if any_lane(behind):
                return False
        at += _STRIDE
    return True


@kernel
def _front_to_back(bins, k, order):
    """Write tile k's list to `order`, sorted roughly by falling depth key (buckets of its float's bits); its length."""
    first, n = bins.first[k], bins.first[k + 1] - bins.first[k]
    key, slots, begin = as_i32(ptr(bins.seen.nearest)), ptr(bins.slot), stack_i64(_BOUNDS)
    low, high = np.int64(_INFINITY), np.int64(0)
    for e in range(first, first + n):
        b = np.int64(get(key, np.int64(get(slots, e))))
        low, high = min(low, b), (max(high, b) if b < _INFINITY else high)
    shift = np.int64(0)
    while (high - low) >> shift >= _BUCKETS:
        shift += 1
    for b in range(_BOUNDS):
        put(begin, b, 0)
    for e in range(first, first + n):
        b = max((high - np.int64(get(key, np.int64(get(slots, e))))) >> shift, 0) + 1
        put(begin, b, get(begin, b) + 1)
    for b in range(_BUCKETS):
        put(begin, b + 1, get(begin, b + 1) + get(begin, b))
    for e in range(first, first + n):
        slot = np.int64(get(slots, e))
        b = max((high - np.int64(get(key, slot))) >> shift, 0)
        order[get(begin, b)] = slot
        put(begin, b, get(begin, b) + 1)
    return n


@kernel
def _draw(tile, bins, order, n, x0, y0, x1, y1, corners, rays, view, cull_faces, counts):
    """Draw a list of triangles into the tile whose pixels are (x0, y0) to (x1, y1)."""
    p = ptr(corners)
    for entry in range(n):
        slot = np.int64(order[entry])
        left, top = max(np.int64(bins.seen.box[slot, 0]), x0), max(np.int64(bins.seen.box[slot, 1]), y0)
        columns = min(np.int64(bins.seen.box[slot, 2]), x1) - left + 1
        rows = min(np.int64(bins.seen.box[slot, 3]), y1) - top + 1
        at = (top - y0) * _STRIDE + left - x0
        if _hidden(tile, at, columns, rows, bins.seen.nearest[slot]):
            continue
        i = np.int64(bins.seen.triangle[slot])
        counts[PAIRS] += 1
        turn, f = edge_functions(view, p, i, left, top, columns + 7, rows)
        if turn == 0:
            turn = -view.turn * plane_side(rays.origin[0], rays.origin[1], rays.origin[2], corners, i)
            if turn < 0:
                f = turned(f)
        if turn * view.turn != cull_faces and turn != 0:
            unsure = _cover(tile, i, columns, rows, at, f)
            if unsure != 0:
                counts[UNCERTAIN] += unsure
                _settle_all(tile, unsure, x0, y0, corners, rays, i)


@kernel
def _finish(tile, x0, y0, x1, y1, corners, rays, face, t):
    """Write the tile's faces and their canonical t."""
    o, last = rays.origin, np.int64(-1)
    plane = plane_of(o[0], o[1], o[2], corners, last)
    for y in range(y0, y1 + 1):
        for x in range(x0, x1 + 1):
            i = np.int64(get(tile.face, (y - y0) * _STRIDE + x - x0))
            face[y, x] = i
            if i < 0:
                t[y, x] = np.inf
                continue
            if i != last:
                plane, last = plane_of(o[0], o[1], o[2], corners, i), i
            dx, dy, dz = pixel_direction(rays, x, y)
            t[y, x] = plane_t(plane, dx, dy, dz)
            if not t[y, x] > 0.0:  # too inaccurate for float64
                t[y, x] = hit_t(pixel_ray(rays, x, y), corners, i)


@kernel
def draw_tiles(ticket, bins, corners, rays, view, cull_faces, face, t, counters):
    """Worker: whole tiles of the picture, each by one thread."""
    tile = Tile(stack_f32(_CELLS), stack_f32(_CELLS), stack_i32(_CELLS), stack_i32(_CELLS), stack_i32(16))
    counts = np.zeros(3, np.int64)
    across = (view.width + TILE - 1) // TILE
    order = np.empty(np.max(np.diff(bins.first)), np.int32)
    k = take(ticket)
    while k >= 0:
        _clear(tile)
        y0, x0 = k // across * TILE, k % across * TILE
        y1, x1 = min(y0 + TILE, view.height) - 1, min(x0 + TILE, view.width) - 1
        n = _front_to_back(bins, k, order)
        _draw(tile, bins, order, n, x0, y0, x1, y1, corners, rays, view, cull_faces, counts)
        _finish(tile, x0, y0, x1, y1, corners, rays, face, t)
        k = take(ticket)
    for c in range(3):
        atomic_add(counters, c, counts[c])
