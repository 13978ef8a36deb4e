"""Bounds of triangles on the screen: which pixels can one cover?

Bounds are conservative: every pixel whose ray meets the triangle lies inside. Most triangles of a large scene are behind
the camera, beside the picture, or fall between pixel centres, and end here; so eight at a time are bounded in float32,
and only the few that come close to the camera's plane or cross it are looked at in float64.
"""

from typing import NamedTuple

import numpy as np

from ..jit import kernel
from ..simd import absolute, all_lanes, as_i32, bits, fma, get, load8, lowest_bit, maximum, minimum, put, select, store, to_f32, to_i32
from .raster_setup import View, corner_of, largest, minus, pixel_vector

BLOCK = 64  # triangles bounded together
_F = np.float32
_U = 2.0**-53
_NEAR32 = 2.0**-5  # a corner this far in front of the camera's plane, for its distance, is placed well by float32,
_NEAR = 2.0**-20  # this far by float64;
_APART = 2.0**-28  # this far, it is clearly on one side of the plane
_SMALL, _LARGE = _F(1e-25), _F(1e25)  # distances between which float32 neither under- nor overflows
_NOWHERE = (0, 0, -1, -1)


class Padding(NamedTuple):
    """How far bounds on the screen are widened, in pixels."""

    x: float
    y: float
    far_x: float  # for triangles that cross the camera's plane
    far_y: float
    quick_x: float  # for float32
    quick_y: float
    slope_x: float  # for float32, times the corners' largest distance / depth
    slope_y: float
    nearer: float  # factor on 1 / depth that makes it a bound of the depth key
    usable: bool  # no: rounding moves rays so far that nothing can be culled


def make_padding(view: View) -> Padding:
    """Directions are rounded (`View.shift_x`), and corners are placed with an error of 8 u distance / depth."""
    if not view.shift_z < 0.25:
        return Padding(*[0.0] * 9, False)
    moved = [shift / (1.0 - view.shift_z) for shift in (view.shift_x, view.shift_y)]
    place = [16.0 * _U * norm / view.norm_z for norm in (view.norm_x, view.norm_y)]
    near, far = ([m + p / limit for m, p in zip(moved, place)] for limit in (_NEAR, _APART))
    quick = [m + 2.0**-22 * size for m, size in zip(moved, (view.width, view.height))]
    slope = [2.0**-20 * norm for norm in (view.norm_x, view.norm_y)]
    usable = far[0] < view.width + 16.0 and far[1] < view.height + 16.0
    nearer = (1.0 + view.shift_z) * (1.0 + 2.0**-14)
    return Padding(*near, *far, *quick, *slope, nearer, usable)


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
def careful_box(view, padding, corners, i):
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
def transpose(corners, first, n, lanes):
    """Write coordinate c of triangle first + k to lanes[BLOCK c + k], k < n; the rest of the block repeats the last."""
    for k in range(BLOCK):
        at = 9 * (first + min(k, n - 1))
        for c in range(9):
            put(lanes, BLOCK * c + k, get(corners, at + c))


@kernel
def _quick_corner(view, lanes, k):
    """(z, x, y, distance) of eight corners."""
    x = load8(lanes, k) - _F(view.eye_x)
    y = load8(lanes, k + BLOCK) - _F(view.eye_y)
    z = load8(lanes, k + 2 * BLOCK) - _F(view.eye_z)
    return (
        fma(z, _F(view.zz), fma(y, _F(view.zy), x * _F(view.zx))),
        fma(z, _F(view.xz), fma(y, _F(view.xy), x * _F(view.xx))),
        fma(z, _F(view.yz), fma(y, _F(view.yy), x * _F(view.yx))),
        maximum(absolute(x), maximum(absolute(y), absolute(z))),
    )


@kernel
def _quick_pixels(a, b, c, pad, last):
    """First and last pixel from 0 to `last` within `pad` of the range of a, b, c; and which lanes have any."""
    low = minimum(maximum(minimum(a, minimum(b, c)) - pad, _F(0.0)), last + _F(1.0))
    high = maximum(minimum(maximum(a, maximum(b, c)) + pad, last), _F(-1.0))
    first, final = to_i32(low), to_i32(high)
    first = select(to_f32(first) < low, first + 1, first)
    return first, final, (first <= final) & (low <= high)


@kernel
def quick_boxes(view, padding, lanes, k, boxes, nearest):
    """Bound the eight triangles from the k-th of a block.

    Writes x0, y0, x1, y1 ((4, BLOCK) int32) and a bound of their depth keys; returns two bit masks: those that may
    cover pixels inside these bounds, and those that `careful_box` must look at. The others cover nothing.
    """
    za, xa, ya, ra = _quick_corner(view, lanes, k)
    zb, xb, yb, rb = _quick_corner(view, lanes, k + 3 * BLOCK)
    zc, xc, yc, rc = _quick_corner(view, lanes, k + 6 * BLOCK)
    behind = _F(-(2.0**-20) * view.norm_z)
    away = (za < ra * behind) & (zb < rb * behind) & (zc < rc * behind)
    front = _F(_NEAR32 * view.norm_z)
    near = (za >= ra * front) & (zb >= rb * front) & (zc >= rc * front)
    near &= (minimum(ra, minimum(rb, rc)) > _SMALL) & (maximum(ra, maximum(rb, rc)) < _LARGE)
    ia, ib, ic = _F(1.0) / za, _F(1.0) / zb, _F(1.0) / zc
    spread = maximum(ra * ia, maximum(rb * ib, rc * ic))
    pad_x, pad_y = spread * _F(padding.slope_x) + _F(padding.quick_x), spread * _F(padding.slope_y) + _F(padding.quick_y)
    x0, x1, any_x = _quick_pixels(xa * ia, xb * ib, xc * ic, pad_x, _F(view.width - 1))
    y0, y1, any_y = _quick_pixels(ya * ia, yb * ib, yc * ic, pad_y, _F(view.height - 1))
    store(boxes, k, x0)
    store(boxes, k + BLOCK, y0)
    store(boxes, k + 2 * BLOCK, x1)
    store(boxes, k + 3 * BLOCK, y1)
    store(nearest, k, maximum(ia, maximum(ib, ic)) * _F(padding.nearer))
    if not padding.usable:
        return 0, 255
    return bits(near & any_x & any_y), bits(~(near | away))
