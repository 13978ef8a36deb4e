"""Which triangles can cover a pixel centre, and in which tiles of the screen: bounds, culling, binning.

Bounds on the screen are conservative: every pixel whose ray meets the triangle lies inside. Most triangles of a large
scene are behind the camera, beside the picture, or fall between pixel centres, and end here.
"""

from typing import NamedTuple

import numpy as np

from ..jit import kernel
from ..parallel import CHUNK, N, new_ticket, run, take
from ..simd import ptr
from .raster_setup import TILE, View, corner_of, largest, minus, pixel_vector

_LEAST_CHUNK = 1024  # triangles
_MOST_COUNTS = 1 << 21  # of the table (chunks, tiles)
_U = 2.0**-53
_NEAR = 2.0**-20  # a corner is well in front of the camera's plane: its place on the screen is accurate
_APART = 2.0**-28  # a corner is clearly on one side of the camera's plane
_NOWHERE = (0, 0, -1, -1)


class Bins(NamedTuple):
    """The triangles left by culling, and the list of them for each tile, in ascending order."""

    triangle: np.ndarray  # (n,) int32; only slots that `slot` names are filled
    box: np.ndarray  # (n, 4) int16: first and last pixel, x0, y0, x1, y1
    first: np.ndarray  # (tiles + 1,) int64: tile k owns slot[first[k]:first[k + 1]]
    slot: np.ndarray  # (pairs,) int32: index into `triangle` and `box`


class Padding(NamedTuple):
    """How far the screen bounds of a triangle are widened, in pixels."""

    x: float
    y: float
    far_x: float  # for triangles that cross the camera's plane
    far_y: float
    usable: bool  # no: rounding moves rays so far that nothing can be culled


def make_padding(view: View) -> Padding:
    """Directions are rounded (`shift`), and corners are placed with a relative error 8 u / `_NEAR` or `_APART`."""
    if not view.shift_z < 0.25:
        return Padding(0.0, 0.0, 0.0, 0.0, False)
    moved = [shift / (1.0 - view.shift_z) for shift in (view.shift_x, view.shift_y)]
    place = [16.0 * _U * norm / view.norm_z for norm in (view.norm_x, view.norm_y)]
    near, far = ([m + p / limit for m, p in zip(moved, place)] for limit in (_NEAR, _APART))
    return Padding(*near, *far, far[0] < view.width + 16.0 and far[1] < view.height + 16.0)


@kernel
def _pixels(low_x, high_x, low_y, high_y, view):
    """Pixels (x0, y0, x1, y1) of the picture whose centres lie in the range; x0 > x1 or y0 > y1 if none do."""
    low_x, high_x = max(low_x, 0.0), min(high_x, view.width - 1.0)
    low_y, high_y = max(low_y, 0.0), min(high_y, view.height - 1.0)
    if not (low_x <= high_x and low_y <= high_y):
        return _NOWHERE
    return int(np.ceil(low_x)), int(np.ceil(low_y)), int(np.floor(high_x)), int(np.floor(high_y))


@kernel
def _opened(low, high, direction, error):
    """The range after a part of the triangle runs off to infinity on one side, or on either when that is not sure."""
    if direction > -error:
        high = np.inf
    if direction < error:
        low = -np.inf
    return low, high


@kernel
def _crossing_range(z, x, r, norm_z, norm_x):
    """Range of x / z over the part of a triangle in front of the camera's plane, which it crosses or touches.

    That part is the hull of the corners in front and of the points where edges meet the plane; those are at infinity.
    """
    low, high = np.inf, -np.inf
    for i in range(3):
        if z[i] >= _APART * norm_z * r[i]:
            low, high = min(low, x[i] / z[i]), max(high, x[i] / z[i])
            for j in range(3):
                if z[j] < -_APART * norm_z * r[j]:
                    error = 32.0 * _U * norm_z * norm_x * r[i] * r[j]
                    low, high = _opened(low, high, z[i] * x[j] - z[j] * x[i], error)
        elif z[i] >= -_APART * norm_z * r[i]:
            if abs(z[i]) > 8.0 * _U * norm_z * r[i]:
                return -np.inf, np.inf
            low, high = _opened(low, high, x[i], 2.0**-8 * norm_x * r[i])
    return low, high


@kernel
def screen_box(view, padding, corners, i):
    """First and last pixel (x0, y0, x1, y1) that triangle i may cover; x0 > x1 or y0 > y1 if it covers none."""
    va = minus(corner_of(corners, i, 0), view.eye_x, view.eye_y, view.eye_z)
    vb = minus(corner_of(corners, i, 1), view.eye_x, view.eye_y, view.eye_z)
    vc = minus(corner_of(corners, i, 2), view.eye_x, view.eye_y, view.eye_z)
    ra, rb, rc = largest(va), largest(vb), largest(vc)
    a, b, c = pixel_vector(view, *va), pixel_vector(view, *vb), pixel_vector(view, *vc)
    if not padding.usable:
        return 0, 0, view.width - 1, view.height - 1
    near = _NEAR * view.norm_z
    if a[0] >= near * ra and b[0] >= near * rb and c[0] >= near * rc:
        xa, xb, xc = a[1] / a[0], b[1] / b[0], c[1] / c[0]
        ya, yb, yc = a[2] / a[0], b[2] / b[0], c[2] / c[0]
        return _pixels(
            min(xa, xb, xc) - padding.x,
            max(xa, xb, xc) + padding.x,
            min(ya, yb, yc) - padding.y,
            max(ya, yb, yc) + padding.y,
            view,
        )
    apart = -_APART * view.norm_z
    if a[0] < apart * ra and b[0] < apart * rb and c[0] < apart * rc:
        return _NOWHERE
    z, r = (a[0], b[0], c[0]), (ra, rb, rc)
    low_x, high_x = _crossing_range(z, (a[1], b[1], c[1]), r, view.norm_z, view.norm_x)
    low_y, high_y = _crossing_range(z, (a[2], b[2], c[2]), r, view.norm_z, view.norm_y)
    return _pixels(low_x - padding.far_x, high_x + padding.far_x, low_y - padding.far_y, high_y + padding.far_y, view)


@kernel
def _cull(ticket, corners, view, padding, triangle, box, left, counts):
    """Bounds of all triangles; chunk k keeps left[k] of them, and has counts[k] of them in each tile."""
    columns, p = (view.width + TILE - 1) // TILE, ptr(corners)
    first = take(ticket)
    while first >= 0:
        chunk, slot = first // ticket[CHUNK], first
        for tile in range(counts.shape[1]):
            counts[chunk, tile] = 0
        for i in range(first, min(first + ticket[CHUNK], ticket[N])):
            x0, y0, x1, y1 = screen_box(view, padding, p, i)
            if x0 <= x1 and y0 <= y1:
                triangle[slot] = i
                box[slot, 0], box[slot, 1], box[slot, 2], box[slot, 3] = x0, y0, x1, y1
                slot += 1
                for row in range(y0 // TILE, y1 // TILE + 1):
                    for column in range(x0 // TILE, x1 // TILE + 1):
                        counts[chunk, row * columns + column] += 1
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
    size = max(_LEAST_CHUNK, -(-n // max(1, _MOST_COUNTS // tiles)))
    chunks = -(-n // size)
    # Untouched pages of these two take no memory: what is culled leaves nothing behind.
    triangle, box = np.empty(n, np.int32), np.empty((n, 4), np.int16)
    left, counts = np.empty(chunks, np.int64), np.empty((chunks, tiles), np.int64)
    run(_cull, threads, new_ticket(n, size), corners, view, make_padding(view), triangle, box, left, counts)
    first = np.zeros(tiles + 1, np.int64)
    _prefix_sums(counts, first)
    slots = np.empty(first[-1], np.int32)
    run(_fill, threads, new_ticket(chunks, 1), size, view.width, left, counts, box, slots)
    return Bins(triangle, box, first, slots)
