"""Binning: conservative screen bounds of triangles, and the triangle list of each screen tile.

Every pixel whose ray meets a triangle lies within the triangle's bounds. Most triangles of a large scene are culled
here, because they are behind the camera, outside the picture, or between pixel centres. Triangles are bounded in
float32, eight at a time; only the few that are close to the camera's plane, or cross it, are bounded in float64.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..kernels.exact.filters import max_magnitude
from ..kernels.jit import inlined, kernel
from ..kernels.parallel import CHUNK, items, new_ticket, run, shares
from ..kernels.simd import (
    absolute,
    as_i32,
    bits,
    fma,
    get,
    load8,
    lowest_bit,
    maximum,
    minimum,
    ptr,
    put,
    select,
    stack_f32,
    stack_i32,
    stack_i64,
    store,
    to_f32,
    to_i32,
)
from .raster_setup import TILE, RasterView, corner_from, pixel_vector

# --- Screen bounds of triangles ---------------------------------------------------------------------------------------


BLOCK = 64  # triangles bounded together
_F = np.float32
_U32, _U64 = 2.0**-24, 2.0**-53
_NEAR32 = 2.0**-5  # least depth / distance at which float32 projects a corner accurately
_NEAR64 = 2.0**-20  # least depth / distance at which float64 projects a corner accurately
_APART = 2.0**-28  # least |depth| / distance of a corner that surely lies on one side of the camera's plane
_SMALL, _LARGE = _F(1e-25), _F(1e25)  # range of distances in which float32 neither underflows nor overflows
_NOWHERE = (0, 0, -1, -1)


class Padding(NamedTuple):
    """Widening of screen bounds, in pixels. All fields but `usable` are float64."""

    near_x: float
    near_y: float
    far_x: float  # for triangles that cross the camera's plane
    far_y: float
    quick_x: float  # constant part of the padding in float32
    quick_y: float
    slope_x: float  # variable part in float32: a factor of the corners' largest distance / depth
    slope_y: float
    nearer: float  # factor from a corner's 1 / depth to a bound of the depth key
    usable: bool  # False: rounding moves rays so far that nothing can be culled


def make_padding(view: RasterView) -> Padding:
    """`Padding` for the rounding of rays, and for the error 8 u norm distance / depth of a projected corner."""
    if not view.shift_z < 0.25:
        return Padding._make((*[0.0] * 9, False))
    moved = [shift / (1.0 - view.shift_z) for shift in (view.shift_x, view.shift_y)]
    place = [16.0 * _U64 * norm / view.norm_z for norm in (view.norm_x, view.norm_y)]
    front, crossing = ([m + p / limit for m, p in zip(moved, place)] for limit in (_NEAR64, _APART))
    quick = [m + 4.0 * _U32 * size for m, size in zip(moved, (view.width, view.height))]
    slope = [32.0 * _U32 * norm for norm in (view.norm_x, view.norm_y)]
    usable = crossing[0] < view.width + 16.0 and crossing[1] < view.height + 16.0
    nearer = (1.0 + view.shift_z) * (1.0 + 2.0**-14)
    return Padding._make((*front, *crossing, *quick, *slope, nearer, usable))


# --- Screen bounds in float64 -----------------------------------------------------------------------------------------


@inlined
def _pixels(low_x, high_x, low_y, high_y, view):
    """The picture's pixels (x0, y0, x1, y1) with centres in the range; x0 > x1 or y0 > y1 if there are none."""
    low_x, high_x = max(low_x, 0.0), min(high_x, view.width - 1.0)
    low_y, high_y = max(low_y, 0.0), min(high_y, view.height - 1.0)
    if not (low_x <= high_x and low_y <= high_y):
        return _NOWHERE
    return int(np.ceil(low_x)), int(np.ceil(low_y)), int(np.floor(high_x)), int(np.floor(high_y))


@inlined
def _opened(low, high, direction, error):
    """Extend the range to infinity on the side of `direction`, or on both sides if its sign is uncertain."""
    if direction > -error:
        high = np.inf
    if direction < error:
        low = -np.inf
    return low, high


@kernel
def _crossing_range(z, x, r, norm_z, norm_x):
    """Range of x / z over the front part of a triangle that crosses or touches the camera's plane.

    The front part is the hull of the corners in front and of the points where edges meet the plane, which project to
    infinity.
    """
    low, high = np.inf, -np.inf
    for i in range(3):
        if z[i] >= _APART * norm_z * r[i]:
            low, high = min(low, x[i] / z[i]), max(high, x[i] / z[i])
            for j in range(3):
                if z[j] < -_APART * norm_z * r[j]:
                    error = 32.0 * _U64 * norm_z * norm_x * r[i] * r[j]
                    low, high = _opened(low, high, z[i] * x[j] - z[j] * x[i], error)
        elif z[i] >= -_APART * norm_z * r[i]:
            if abs(z[i]) > 8.0 * _U64 * norm_z * r[i]:
                return -np.inf, np.inf
            # On the plane or very close to it: the sign of x determines the sign of infinity
            low, high = _opened(low, high, x[i], 2.0**-8 * norm_x * r[i])
    return low, high


@kernel
def careful_box(view, padding, corners, i):
    """Pixel bounds (x0, y0, x1, y1), inclusive, of triangle i; x0 > x1 or y0 > y1 if it covers no pixel."""
    if not padding.usable:
        return 0, 0, view.width - 1, view.height - 1
    eye = (view.eye_x, view.eye_y, view.eye_z)
    va, vb, vc = corner_from(corners, i, 0, eye), corner_from(corners, i, 1, eye), corner_from(corners, i, 2, eye)
    a, b, c = pixel_vector(view, va), pixel_vector(view, vb), pixel_vector(view, vc)
    z, x, y = (a[0], b[0], c[0]), (a[1], b[1], c[1]), (a[2], b[2], c[2])
    r = (max_magnitude(va), max_magnitude(vb), max_magnitude(vc))
    front, behind = _NEAR64 * view.norm_z, -_APART * view.norm_z
    if z[0] >= front * r[0] and z[1] >= front * r[1] and z[2] >= front * r[2]:
        x0, x1, x2 = x[0] / z[0], x[1] / z[1], x[2] / z[2]
        y0, y1, y2 = y[0] / z[0], y[1] / z[1], y[2] / z[2]
        return _pixels(
            min(x0, x1, x2) - padding.near_x,
            max(x0, x1, x2) + padding.near_x,
            min(y0, y1, y2) - padding.near_y,
            max(y0, y1, y2) + padding.near_y,
            view,
        )
    if z[0] < behind * r[0] and z[1] < behind * r[1] and z[2] < behind * r[2]:
        return _NOWHERE
    low_x, high_x = _crossing_range(z, x, r, view.norm_z, view.norm_x)
    low_y, high_y = _crossing_range(z, y, r, view.norm_z, view.norm_y)
    pad_x, pad_y = padding.far_x, padding.far_y
    return _pixels(low_x - pad_x, high_x + pad_x, low_y - pad_y, high_y + pad_y, view)


# --- Screen bounds in float32 -----------------------------------------------------------------------------------------


@inlined
def transpose(corners, first, n, lanes):
    """Write coordinate c of triangle first + k to lanes[BLOCK c + k], k < n; beyond n, repeat the last triangle."""
    for k in range(BLOCK):
        at = 9 * (first + min(k, n - 1))
        for c in range(9):
            put(lanes, BLOCK * c + k, get(corners, at + c))


@inlined
def _quick_corner(view, lanes, k):
    """(z, x, y, distance) of eight corners, in pixel coordinates, with error at most 6 u norm distance."""
    x = load8(lanes, k) - _F(view.eye_x)
    y = load8(lanes, k + BLOCK) - _F(view.eye_y)
    z = load8(lanes, k + 2 * BLOCK) - _F(view.eye_z)
    return (
        fma(z, _F(view.zz), fma(y, _F(view.zy), x * _F(view.zx))),
        fma(z, _F(view.xz), fma(y, _F(view.xy), x * _F(view.xx))),
        fma(z, _F(view.yz), fma(y, _F(view.yy), x * _F(view.yx))),
        maximum(absolute(x), maximum(absolute(y), absolute(z))),
    )


@inlined
def _quick_pixels(a, b, c, pad, last):
    """(first pixel, last pixel, mask of lanes with any pixel): within `pad` of the range of a, b, c, in [0, `last`]."""
    low = minimum(maximum(minimum(a, minimum(b, c)) - pad, _F(0.0)), last + _F(1.0))
    high = maximum(minimum(maximum(a, maximum(b, c)) + pad, last), _F(-1.0))
    first, final = to_i32(low), to_i32(high)
    first = select(to_f32(first) < low, first + 1, first)
    return first, final, (first <= final) & (low <= high)


@inlined
def quick_boxes(view, padding, lanes, k, boxes, nearest):
    """Bound eight triangles of a block, starting at the k-th.

    Write x0, y0, x1, y1 ((4, BLOCK) int32) and a bound of the depth keys. Return two bit masks: triangles that may
    cover pixels inside these bounds, and triangles that need `careful_box`. The others cover no pixel.

    With q the largest distance / depth, the error of x / z is at most 9 u q (|row x| + |x / z| norm_z). Within twice
    the picture, it is at most `slope_x` q. Corners farther out stay outside, since q norm_z <= 1 / _NEAR32.
    """
    za, xa, ya, ra = _quick_corner(view, lanes, k)
    zb, xb, yb, rb = _quick_corner(view, lanes, k + 3 * BLOCK)
    zc, xc, yc, rc = _quick_corner(view, lanes, k + 6 * BLOCK)
    behind = _F(-16.0 * _U32 * view.norm_z)
    away = (za < ra * behind) & (zb < rb * behind) & (zc < rc * behind)
    least = _F(_NEAR32 * view.norm_z)
    projectable = (za >= ra * least) & (zb >= rb * least) & (zc >= rc * least)
    projectable &= (minimum(ra, minimum(rb, rc)) > _SMALL) & (maximum(ra, maximum(rb, rc)) < _LARGE)
    ia, ib, ic = _F(1.0) / za, _F(1.0) / zb, _F(1.0) / zc
    q = maximum(ra * ia, maximum(rb * ib, rc * ic))
    pad_x = q * _F(padding.slope_x) + _F(padding.quick_x)
    pad_y = q * _F(padding.slope_y) + _F(padding.quick_y)
    x0, x1, any_x = _quick_pixels(xa * ia, xb * ib, xc * ic, pad_x, _F(view.width - 1))
    y0, y1, any_y = _quick_pixels(ya * ia, yb * ib, yc * ic, pad_y, _F(view.height - 1))
    store(boxes, k, x0)
    store(boxes, k + BLOCK, y0)
    store(boxes, k + 2 * BLOCK, x1)
    store(boxes, k + 3 * BLOCK, y1)
    store(nearest, k, maximum(ia, maximum(ib, ic)) * _F(padding.nearer))
    if not padding.usable:
        return 0, 255
    return bits(projectable & any_x & any_y), bits(~(projectable | away))


# --- Triangle lists of tiles ------------------------------------------------------------------------------------------


_LEAST_CHUNK, _MOST_CHUNKS = 16 * BLOCK, 256  # triangles per chunk; enough chunks to keep many threads busy
_MOST_COUNTS = 1 << 22  # elements of the table (chunks, tiles)
_BOXES, _LANES = 4 * BLOCK, 9 * BLOCK
_BUCKETS = 128  # depth buckets
_BOUNDS = _BUCKETS + 1
_INFINITY = 0x7F800000  # the bits of float32's infinity


class Survivors(NamedTuple):
    """The triangles that survive culling. Only slots in `TileBins.slot` are filled; other pages stay untouched."""

    triangle: np.ndarray  # (n,) int32
    box: np.ndarray  # (n, 4) int16: first and last pixel, x0, y0, x1, y1
    nearest: np.ndarray  # (n,) float32: upper bound of the triangle's depth key 1 / t


class TileBins(NamedTuple):
    """The candidate triangles of each tile: slot[first[k]:first[k + 1]] for tile k, in ascending triangle order."""

    survivors: Survivors
    first: np.ndarray  # (tiles + 1,) int64
    slot: np.ndarray  # (pairs,) int32: index into the arrays of `survivors`


def tiles_across(pixels: int) -> int:
    """Number of tiles along an edge of `pixels` pixels."""
    return -(-pixels // TILE)


@inlined
def _keep(survivors, slot, i, box, nearest, columns, counts):
    """Write a triangle to its slot and count it in its tiles, unless its box is empty; return the next slot."""
    x0, y0, x1, y1 = box
    if x0 > x1 or y0 > y1:
        return slot
    survivors.triangle[slot], survivors.nearest[slot] = i, nearest
    survivors.box[slot, 0], survivors.box[slot, 1], survivors.box[slot, 2], survivors.box[slot, 3] = x0, y0, x1, y1
    for row in range(y0 // TILE, y1 // TILE + 1):
        for column in range(x0 // TILE, x1 // TILE + 1):
            counts[row * columns + column] += 1
    return slot + 1


@inlined
def _quick_box(boxes, k):
    return (
        get(boxes, k),
        get(boxes, k + BLOCK),
        get(boxes, k + 2 * BLOCK),
        get(boxes, k + 3 * BLOCK),
    )


@kernel
def _cull(ticket, corners, view, padding, columns, survivors, lengths, counts):
    """Worker: bound all triangles; lengths[k] of chunk k survive, counts[k] of them in each tile."""
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
                    slot = _keep(survivors, slot, i, box, key, columns, row)
        lengths[chunk] = slot - first


@kernel
def _prefix_sums(counts, first):
    """Replace counts[chunk, tile] by the start of the chunk's part of the tile's list, which starts at first[tile]."""
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
def _fill(ticket, size, columns, lengths, cursors, box, slots):
    """Worker: write the tiles' lists, chunk by chunk of `size` triangles."""
    for chunk in items(ticket):
        for slot in range(chunk * size, chunk * size + lengths[chunk]):
            for row in range(box[slot, 1] // TILE, box[slot, 3] // TILE + 1):
                for column in range(box[slot, 0] // TILE, box[slot, 2] // TILE + 1):
                    tile = row * columns + column
                    slots[cursors[chunk, tile]] = slot
                    cursors[chunk, tile] += 1


def bin_triangles(corners: NDArray[np.float32], view: RasterView, threads: int) -> TileBins:
    """Cull the triangles, (n, 9) float32, and list the remaining ones by tile."""
    n, columns = len(corners), tiles_across(view.width)
    tiles = columns * tiles_across(view.height)
    size = max(_LEAST_CHUNK, -(-n // max(1, min(_MOST_CHUNKS, _MOST_COUNTS // tiles))))
    chunks = -(-n // size)
    survivors = Survivors(np.empty(n, np.int32), np.empty((n, 4), np.int16), np.empty(n, np.float32))
    lengths, counts = np.empty(chunks, np.int64), np.empty((chunks, tiles), np.int64)
    run(_cull, threads, new_ticket(n, size), corners, view, make_padding(view), columns, survivors, lengths, counts)
    first = np.zeros(tiles + 1, np.int64)
    _prefix_sums(counts, first)
    slots = np.empty(first[-1], np.int32)
    run(_fill, threads, new_ticket(chunks, 1), size, columns, lengths, counts, survivors.box, slots)
    return TileBins(survivors, first, slots)


@inlined
def _bucket(key, slot, highest, shift):
    """The depth bucket of a slot: lower for larger depth keys. Positive floats sort like their bit patterns."""
    return max(highest - get(key, slot), 0) >> shift


@kernel
def front_to_back(bins, tile, order):
    """Write a tile's slots to `order`, roughly by decreasing depth key of the nearest corner; return their number."""
    first, n = bins.first[tile], bins.first[tile + 1] - bins.first[tile]
    key, slots, start = as_i32(ptr(bins.survivors.nearest)), ptr(bins.slot), stack_i64(_BOUNDS)
    lowest, highest = np.int64(_INFINITY), 0
    for e in range(first, first + n):
        k = get(key, get(slots, e))
        lowest = k if k < lowest else lowest
        highest = k if highest < k < _INFINITY else highest  # triangles that cross the camera's plane go to bucket 0
    shift = 0
    while (highest - lowest) >> shift >= _BUCKETS:
        shift += 1
    for b in range(_BOUNDS):
        put(start, b, 0)
    for e in range(first, first + n):
        b = _bucket(key, get(slots, e), highest, shift) + 1
        put(start, b, get(start, b) + 1)
    for b in range(_BUCKETS):
        put(start, b + 1, get(start, b + 1) + get(start, b))
    for e in range(first, first + n):
        slot = get(slots, e)
        b = _bucket(key, slot, highest, shift)
        order[get(start, b)] = slot
        put(start, b, get(start, b) + 1)
    return n
