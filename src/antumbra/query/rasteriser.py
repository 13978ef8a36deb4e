"""The rasteriser: primary visibility, bit-identical to tracing each pixel's ray against every triangle.

For each pixel, a tile stores the visible face and an interval that surely contains the face's depth key 1 / t. A
triangle takes over a pixel if it surely covers it and its own interval lies above the pixel's. It is rejected if it
surely misses the pixel, or if its interval lies below. `filters.meets` and `hits.hit_t` decide the remaining cases, as
the contract defines, so the result does not depend on the drawing order. Triangles are drawn front to back, so that
most hidden ones are rejected early.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..base.errors import InputError
from ..kernels.exact.filters import comes_first, meets, plane_side
from ..kernels.jit import F32Ptr, I32Ptr, inlined, kernel
from ..kernels.parallel import items, new_ticket, run, thread_count
from ..kernels.simd import (
    any_lane,
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
    stack_array,
    stack_f32,
    stack_i32,
    store,
    to_f32,
    to_i32,
)
from ..scene.camera import CameraRays
from .gbuffer import pixel_ray
from .raster_bins import bin_triangles, front_to_back, tiles_across
from .raster_setup import NO_PLANE, STRIDE, TILE, edge_functions, eye_plane, make_view, negated, plane_t

# --- Drawing a tile ---------------------------------------------------------------------------------------------------


RASTER_COUNTERS = ("listed", "drawn", "pixels", "uncertain", "ties")
"""Names of the counters of `rasterise`.

- listed: (tile, triangle) pairs
- drawn: pairs not rejected as hidden
- pixels: pixels inside the bounds of drawn pairs
- uncertain: pixels whose coverage is undecided in float32
- ties: covered pixels whose nearest face is undecided in float32
"""
_LISTED, _DRAWN, _PIXELS, _UNCERTAIN, _TIES = range(len(RASTER_COUNTERS))
_COUNTS = len(RASTER_COUNTERS)

_F = np.float32
_CELLS = TILE * STRIDE
_FLAT = _F(1e-20)  # an edge function with a smaller slope per pixel clips no row
_NEXT_BELOW, _NEXT_ABOVE, _TINY = 1.0 - 2.0**-22, 1.0 + 2.0**-22, 1e-37  # above the error of rounding a key to float32


class RasterTile(NamedTuple):
    """Pointers to the state of a tile, whose pixel (x, y) is element y * STRIDE + x."""

    low: F32Ptr  # float32: least possible depth key of the face; -inf: no face
    high: F32Ptr  # float32: largest possible depth key of the face; undefined without a face
    face: I32Ptr  # int32; -1: no face
    unsure: I32Ptr  # int32: uncertain pixels of the last triangle, times 2, plus 1 if it surely covers them
    ranges: I32Ptr  # (16,) int32: first pixel to draw in each of eight rows, then one past the last of each


@inlined
def _clear(tile):
    for k in range(0, _CELLS, 8):
        store(tile.low, k, splat8(_F(-np.inf)))
        store(tile.face, k, splat8(-1))


@inlined
def _hidden(tile, at, columns, rows, nearest):
    """True if all `columns` x `rows` pixels from pixel `at` have a face surely in front of depth key `nearest`."""
    for _ in range(rows):
        for x in range(0, columns, 8):
            if any_lane((load8(tile.low, at + x) <= nearest) & (iota8() < columns - x)):
                return False
        at += STRIDE
    return True


@inlined
def _clip_rows(a, b, c, y, low, high):
    """Clip the pixel ranges of eight rows y to the pixels that an edge function does not exclude."""
    if abs(a) < _FLAT:
        return low, high
    pad = _F(0.01) + _F(2.0**-21) * (abs(c) + abs(b) * _F(STRIDE) + _F(1.0)) / abs(a)  # of c + b y + 1, and of x
    x = fma(y, b, c + _F(1.0)) * (_F(-1.0) / a)
    if a > _F(0.0):
        return maximum(low, x - pad), high
    return low, minimum(high, x + pad)


@inlined
def _set_ranges(tile, f, y, columns, rows):
    """Set `tile.ranges` of rows y to y + 7 of a triangle's box."""
    low, high = splat8(_F(0.0)), splat8(_F(columns - 1))
    if columns * rows > 64:  # for fewer pixels, clipping costs more than it saves
        down = to_f32(iota8() + y)
        low, high = _clip_rows(f.a0, f.b0, f.c0, down, low, high)
        low, high = _clip_rows(f.a1, f.b1, f.c1, down, low, high)
        low, high = _clip_rows(f.a2, f.b2, f.c2, down, low, high)
    store(tile.ranges, 0, to_i32(minimum(low, _F(TILE))))
    store(tile.ranges, 8, to_i32(maximum(high + _F(1.0), _F(0.0))))


@kernel
def _cover(tile, i, columns, rows, at, f):
    """Draw triangle i into `columns` x `rows` pixels from pixel `at`. Return the number of pixels in `tile.unsure`."""
    lanes, n = to_f32(iota8()), 0
    for y in range(rows):
        if y & 7 == 0:
            _set_ranges(tile, f, y, columns, rows)
        down = _F(y)
        r0, r1, r2 = f.c0 + f.b0 * down, f.c1 + f.b1 * down, f.c2 + f.b2 * down
        key_row = f.key_c + f.key_b * down
        for x in range(get(tile.ranges, y & 7), get(tile.ranges, 8 + (y & 7)), 8):
            right = lanes + _F(x)
            inside = minimum(minimum(fma(right, f.a0, r0), fma(right, f.a1, r1)), fma(right, f.a2, r2))
            key = fma(right, f.key_a, key_row)
            key_low, key_high = key - f.key_error, key + f.key_error
            k = at + x
            low = load8(tile.low, k)
            candidate = (inside >= _F(-1.0)) & (key_high >= low)
            if any_lane(candidate):
                high, face = load8(tile.high, k), load8(tile.face, k)
                covers = inside > _F(1.0)
                # Testing `face` also keeps LLVM from a masked store, which takes 20 cycles on some processors
                wins = candidate & covers & ((face < 0) | (key_low > high))
                store(tile.low, k, select(wins, key_low, low))
                store(tile.high, k, select(wins, key_high, high))
                store(tile.face, k, select(wins, splat8(i), face))
                unsure, sure = bits(candidate & ~wins), bits(covers)
                while unsure != 0:
                    lane = lowest_bit(unsure)
                    put(tile.unsure, n, 2 * (k + lane) + ((sure >> lane) & 1))
                    unsure &= unsure - 1
                    n += 1
        at += STRIDE
    return n


@kernel
def _settle(tile, n, x0, y0, corners, rays, i):
    """Decide the n uncertain pixels of triangle i exactly. Return how many of them it surely covers."""
    p, o, ties = ptr(corners), rays.origin, 0
    mine, other = eye_plane(p, i, o), NO_PLANE
    for u in range(n):
        entry = get(tile.unsure, u)
        at = entry >> 1
        if at % STRIDE >= TILE:  # beyond the right edge
            continue
        ray = pixel_ray(rays, x0 + at % STRIDE, y0 + at // STRIDE)
        ties += entry & 1
        if entry & 1 == 0 and meets(ray, p, i) == 0:
            continue
        t, j = plane_t(mine, ray, p), get(tile.face, at)
        if j >= 0:
            if j != other.triangle:
                other = eye_plane(p, j, o)
            other_t = plane_t(other, ray, p)
            if not comes_first(ray, p, i, i, t, p, j, j, other_t):
                continue
        key = 1.0 / t
        put(tile.low, at, _F(key * _NEXT_BELOW - _TINY))
        put(tile.high, at, _F(key * _NEXT_ABOVE + _TINY))
        put(tile.face, at, i)
    return ties


@kernel
def _draw(tile, bins, order, n, window, corners, rays, view, cull_faces, counts):
    """Draw a list of triangles into the tile that covers the window (x0, y0, x1, y1), inclusive."""
    p, (x0, y0, x1, y1) = ptr(corners), window
    boxes, triangles, nearest = ptr(bins.survivors.box), ptr(bins.survivors.triangle), ptr(bins.survivors.nearest)
    for entry in range(n):
        slot = np.int64(order[entry])
        x, y = max(get(boxes, 4 * slot), x0), max(get(boxes, 4 * slot + 1), y0)
        columns = min(get(boxes, 4 * slot + 2), x1) - x + 1
        rows = min(get(boxes, 4 * slot + 3), y1) - y + 1
        at = (y - y0) * STRIDE + x - x0
        if _hidden(tile, at, columns, rows, get(nearest, slot)):
            continue
        i = get(triangles, slot)
        counts[_DRAWN] += 1
        turn, f = edge_functions(view, p, i, x, y, columns + 7, rows)
        if turn == 0:
            turn = -view.turn * plane_side(view.eye_x, view.eye_y, view.eye_z, p, i)
            if turn < 0:
                f = negated(f)
        if turn != 0 and turn * view.turn != cull_faces:  # 0: no ray from the eye meets the triangle
            counts[_PIXELS] += columns * rows
            unsure = _cover(tile, i, columns, rows, at, f)
            if unsure != 0:
                ties = _settle(tile, unsure, x0, y0, corners, rays, i)
                counts[_UNCERTAIN] += unsure - ties
                counts[_TIES] += ties


@kernel
def _finish(tile, window, corners, rays, face, t):
    """Write the tile's faces and their canonical t."""
    p, o, plane = ptr(corners), rays.origin, NO_PLANE
    x0, y0, x1, y1 = window
    for y in range(y0, y1 + 1):
        for x in range(x0, x1 + 1):
            i = get(tile.face, (y - y0) * STRIDE + x - x0)
            face[y, x] = i
            if i >= 0 and i != plane.triangle:
                plane = eye_plane(p, i, o)
            t[y, x] = plane_t(plane, pixel_ray(rays, x, y), p) if i >= 0 else np.inf


@kernel
def draw_tiles(ticket, bins, corners, rays, view, cull_faces, face, t, counters, order):
    """Worker: draw whole tiles of the picture. `order`: the thread's buffer for the longest list."""
    tile = RasterTile(stack_f32(_CELLS), stack_f32(_CELLS), stack_i32(_CELLS), stack_i32(_CELLS), stack_i32(16))
    counts = stack_array(np.int64, _COUNTS)
    for c in range(_COUNTS):
        counts[c] = 0
    across = -(-view.width // TILE)
    for k in items(ticket):
        _clear(tile)
        x0, y0 = k % across * TILE, k // across * TILE
        window = (x0, y0, min(x0 + TILE, view.width) - 1, min(y0 + TILE, view.height) - 1)
        n = front_to_back(bins, k, order)
        counts[_LISTED] += n
        _draw(tile, bins, order, n, window, corners, rays, view, cull_faces, counts)
        _finish(tile, window, corners, rays, face, t)
    for c in range(_COUNTS):
        atomic_add(counters, c, counts[c])


# --- `rasterise` ------------------------------------------------------------------------------------------------------


__all__ = ["RASTER_COUNTERS", "new_raster_counters", "rasterise"]


def new_raster_counters() -> NDArray[np.int64]:
    """Zeros for the `counters` of `rasterise`, in the order of RASTER_COUNTERS."""
    return np.zeros(len(RASTER_COUNTERS), np.int64)


def rasterise(
    corners: NDArray[np.float32],
    rays: CameraRays,
    threads: int | None = None,
    cull_faces: int = 0,
    counters: NDArray[np.int64] | None = None,
) -> tuple[NDArray[np.int32], NDArray[np.float64]]:
    """The nearest triangle at each pixel centre.

    Parameters
    ----------
    corners : (n, 9) float32, C-contiguous, finite
        Three corners per row, in the recentred frame: a view of `Triangles.vertices`.
    rays : CameraRays
    threads : int, optional
        None: all cores. Does not affect the result.
    cull_faces : int
        0: none. 1, -1: ignore triangles whose normal points along the ray, or against it.
    counters : (5,) int64, optional
        From `new_raster_counters`; counts are added.

    Returns
    -------
    face : (H, W) int32
        Row of `corners`, -1 in the background. Among triangles at the same real t, rounded to float64, one whose front
        faces the eye wins, then the lowest row.
    t : (H, W) float64
        Depth, in lengths of the pixel's direction; inf in the background.

    Raises
    ------
    InputError
        If `corners` has another shape, dtype or layout, or `cull_faces` is not -1, 0 or 1.

    Notes
    -----
    Pixel (x, y) has the ray ``gbuffer.pixel_ray(rays, x, y)``, over (0, inf). ``filters.meets`` defines coverage, and
    ``hits.hit_t`` defines t. Triangles are culled and listed by screen tile (`raster_bins`). Each tile is then drawn by
    one thread (`draw_tiles`).
    """
    corners = _checked(corners)
    if cull_faces not in (-1, 0, 1):
        raise InputError(f"cull_faces is {cull_faces!r}; it must be 0 (none), 1 (along the ray) or -1 (against it)")
    face, t = np.empty((rays.height, rays.width), np.int32), np.empty((rays.height, rays.width))
    threads, view = thread_count(threads), make_view(rays)
    counters = new_raster_counters() if counters is None else counters
    bins = bin_triangles(corners, view, threads)
    tiles, longest = tiles_across(rays.width) * tiles_across(rays.height), int(np.diff(bins.first).max())
    run(
        draw_tiles,
        threads,
        new_ticket(tiles, 1),
        bins,
        corners,
        rays,
        view,
        int(cull_faces),
        face,
        t,
        counters,
        own=lambda: (np.empty(longest, np.int32),),
    )
    return face, t


def _checked(corners: object) -> NDArray[np.float32]:
    if not (isinstance(corners, np.ndarray) and corners.ndim == 2 and corners.shape[1] == 9):
        raise InputError(f"corners must be an (n, 9) array, not {getattr(corners, 'shape', type(corners).__name__)}")
    if corners.dtype != np.float32 or not corners.flags.c_contiguous:
        raise InputError("corners must be C-contiguous float32: numpy.ascontiguousarray(corners, numpy.float32)")
    return corners
