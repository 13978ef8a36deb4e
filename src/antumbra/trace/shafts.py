"""The shafts of a tile: from the box of its receivers to the box of each group of strata.

Let c be the centre of the receivers' box and rx its half extents. Let D be the centre of a group's box relative to c,
and ry its half extents. All segments of the shaft lie in the convex hull of the two boxes. Four planes bound the hull
sideways. Let m be at right angles to D and to one of the axes. A plane has the normal w = +-m - k D and the support of
the two boxes

    b = max(|w| . rx, w . D + |w| . ry)

so that w . x <= b in the whole hull. The choice k = (|m| . ry - |m| . rx) / D . D makes the plane touch both boxes, up
to second order, but any k is correct. The whole shaft misses a triangle that lies wholly beyond one of the four planes.
Planes at its two ends cull few more, because the block's box has been tested.
"""

from typing import NamedTuple

import numpy as np

from ..kernels.jit import inlined, kernel
from ..kernels.simd import absolute, get, maximum, put, splat16, store
from ..kernels.vec import Vec, abs_dot, abs_dots, dot, keep, middles_and_halves, rows, scalars, total
from .lighttable import ALL_GROUPS

_F = np.float32
_ROUNDING = _F(24 * 2.0**-24)
_TINY = _F(1e-37)  # more than the error of a sum of products by underflow
N = ALL_GROUPS  # a row's length
D, HALF, TWIST, SPAN, LEVER, PLANES = 0, 3 * N, 6 * N, 7 * N, 8 * N, 9 * N
PLANE = 5 * N  # rows of a plane: w (3), b, error for each unit of a corner's largest coordinate
SHAFT_FLOATS = PLANES + 4 * PLANE
_MADE = 12  # word of a tile's `info`: 1 if its shafts are written


class Axis(NamedTuple):
    """The shaft to one group; float32 scalars."""

    d: Vec  # from the centre of the receivers' box to the centre of the group's box
    half: Vec  # half extents of the group's box
    twist: float  # sum of ry_i (rx_j + rx_k)
    span: float  # at least |d|_1 of any segment, plus |rx|_1 and |ry|_1
    lever: float  # |rx|_1 |D|_1


@inlined
def axis_of(shafts, group):
    """The `Axis` of a group."""
    return Axis(
        scalars(shafts, D + group, N),
        scalars(shafts, HALF + group, N),
        get(shafts, TWIST + group),
        get(shafts, SPAN + group),
        get(shafts, LEVER + group),
    )


@inlined
def _sideways(d, axis):
    """d turned by 90 degrees around an axis: at right angles to d and to the axis."""
    zero = splat16(_F(0.0))
    if axis == 0:
        return Vec(zero, -d.z, d.y)
    if axis == 1:
        return Vec(d.z, zero, -d.x)
    return Vec(-d.y, d.x, zero)


@inlined
def _bound_plane(shafts, at, w, d, receivers, half, size):
    """Write the plane with normal w and the support of the two boxes."""
    keep(shafts, at, N, w)
    support = maximum(abs_dots(w, receivers), dot(w, d) + abs_dot(w, half))
    error = total(w) * _ROUNDING + _TINY
    store(shafts, at + 3 * N, support + absolute(support) * _F(2.0**-18) + error * size + _TINY)
    store(shafts, at + 4 * N, error)


@inlined
def forget_shafts(tile):
    """Note that the tile's receivers or samples are new."""
    put(tile.info, _MADE, _F(0.0))


@inlined
def have_shafts(tile):
    """Write the shafts of a tile, unless that has been done. Many tiles meet no block, and need none."""
    if get(tile.info, _MADE) == _F(0.0):
        make_shafts(tile.info, tile.groups, tile.shafts)
        put(tile.info, _MADE, _F(1.0))


@kernel
def make_shafts(info, groups, shafts):
    """Write the shafts of a tile to all groups, 16 at a time; `info` as in `tile.Tile`."""
    c, receivers = scalars(info, 0, 1), scalars(info, 3, 1)
    x1 = receivers.x + receivers.y + receivers.z
    dx = abs(_F(0.5) * (get(groups, 1) + get(groups, 3 * N + 1)) - c.x)
    dy = abs(_F(0.5) * (get(groups, N + 1) + get(groups, 4 * N + 1)) - c.y)
    dz = abs(_F(0.5) * (get(groups, 2 * N + 1) + get(groups, 5 * N + 1)) - c.z)
    along = 0 if dx >= dy and dx >= dz else (1 if dy >= dz else 2)
    for batch in range(0, N, 16):
        low, high = rows(groups, batch, N), rows(groups, 3 * N + batch, N)
        centre, half = middles_and_halves(low, high)
        d = Vec(centre.x - c.x, centre.y - c.y, centre.z - c.z)
        d1, y1 = total(d), half.x + half.y + half.z
        twist = half.x * (receivers.y + receivers.z) + half.y * (receivers.x + receivers.z)
        span = d1 + (y1 + x1) * _F(2.0)
        keep(shafts, D + batch, N, d)
        keep(shafts, HALF + batch, N, half)
        store(shafts, TWIST + batch, twist + half.z * (receivers.x + receivers.y))
        store(shafts, SPAN + batch, span)
        store(shafts, LEVER + batch, d1 * x1)
        inverse = splat16(_F(1.0)) / maximum(dot(d, d), splat16(_F(1e-30)))
        at = PLANES + batch
        for turn in (1, 2):
            m = _sideways(d, (along + turn) % 3)
            k = (abs_dot(m, half) - abs_dots(m, receivers)) * inverse
            back = Vec(d.x * k, d.y * k, d.z * k)
            _bound_plane(shafts, at, Vec(m.x - back.x, m.y - back.y, m.z - back.z), d, receivers, half, span)
            at += PLANE
            _bound_plane(shafts, at, Vec(-m.x - back.x, -m.y - back.y, -m.z - back.z), d, receivers, half, span)
            at += PLANE
