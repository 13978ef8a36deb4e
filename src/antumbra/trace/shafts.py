"""Shafts, beams and segments of a tile, and their tests against the box of a block.

Shafts. A tile has one shaft to each group of strata. Let c be the centre of the receivers' box and rx its half extents.
Let D be the centre of a group's box relative to c, and ry its half extents. All segments of the shaft lie in the convex
hull of the two boxes, which four planes bound sideways. Let m be perpendicular to D and to one of the axes. A plane has
the normal w = +-m - k D and the support of the two boxes

    b = max(|w| . rx, w . D + |w| . ry)

so that w . x <= b in the whole hull. The choice k = (|m| . ry - |m| . rx) / D . D makes the plane touch both boxes, up
to second order, but any k is correct. The shaft misses a triangle that lies entirely beyond one of the four planes.
Planes at its two ends would cull few more, because the block's box has been tested before.

Beams. These are the frusta of multi-frusta tracing [Benthin and Wald 2009], from one receiver each to the box of all
its samples; lanes are receivers. Near the receivers they are narrower than shafts, which start from the box of all
receivers; near the light they are wider. Let D be the vector from the receiver to the centre of the box, and h the half
extents of the box. At a sample D + y, the edge functions of `frusta.shaft_culling` along D change by y . N, so by at
most h . |N|.

Segments. Slab tests use reciprocals that are stored for all blocks. A segment from o along d is in the slab of a box
with centre c and half extent e where ``|o + t d - c| <= e``, so between (c - o) / d - e / |d| and (c - o) / d + e /
|d|. Let R be at least all magnitudes of o, o + d and c -+ e, and u the unit roundoff.

- d is rounded, and a component below 8u R is replaced by 4u R. So its error is at most 12u R, as is that of a point
  with t up to 1.
- (c - o) / d accumulates four roundings of at most 2R / |d|, and the sums with e / |d| less than 6u R / |d|.

Widening e by 32u R covers both. A quotient that overflows only keeps a segment.

Separating axes. The axes are the three axes of the box and their cross products with the segments. A segment may meet
the box if no axis separates them. The errors of a segment's midpoint and of its distance from the box's centre are at
most 4u of the coordinates. `_PAD` covers them eight times over, `_TINY` covers underflow, and `_SURE` covers quotients
of numbers that underflow.
"""

from typing import NamedTuple

import numpy as np

from ..kernels.jit import F32x16, inlined, kernel
from ..kernels.simd import (
    absolute,
    as_i32,
    bits,
    broadcast16,
    fma,
    get,
    load16,
    maximum,
    minimum,
    put,
    reduce_max,
    select,
    splat16,
    store,
)
from ..kernels.vec3 import (
    Vec3,
    abs_dot,
    abs_dots,
    add3,
    broadcasts,
    dot,
    get3,
    largest,
    magnitudes,
    middles_and_halves,
    rows,
    store3,
    subtract3,
    total,
)
from .light_table import ALL_GROUPS, POINTS

# --- Shafts -----------------------------------------------------------------------------------------------------------


_F = np.float32
_ROUNDING = _F(24 * 2.0**-24)
_TINY = _F(1e-37)  # more than the underflow error of a sum of products
N = ALL_GROUPS  # length of a row
D, HALF, TWIST, SPAN, LEVER, PLANES = 0, 3 * N, 6 * N, 7 * N, 8 * N, 9 * N
PLANE = 5 * N  # rows of a plane: w (3), b, error per unit of a corner's largest coordinate
_REACHES = PLANES + 4 * PLANE  # a `Reach` of the strata
REACH_FLOATS = 4 * 16
SHAFT_FLOATS = _REACHES + REACH_FLOATS
_MADE = 12  # word of a tile's `info`: 1 if its shafts have been computed


class Axis(NamedTuple):
    """The shaft to one group; float32 scalars."""

    d: Vec3  # from the centre of the receivers' box to the centre of the group's box
    half: Vec3  # half extents of the group's box
    twist: float  # sum of ry_i (rx_j + rx_k)
    span: float  # at least |d|_1 of any segment, plus |rx|_1 and |ry|_1
    lever: float  # |rx|_1 |D|_1


@inlined
def axis_of(shafts, group):
    """The `Axis` of a group."""
    return Axis(
        get3(shafts, D + group, N),
        get3(shafts, HALF + group, N),
        get(shafts, TWIST + group),
        get(shafts, SPAN + group),
        get(shafts, LEVER + group),
    )


@inlined
def _sideways(d, axis):
    """d rotated by 90 degrees around an axis: perpendicular to d and to the axis."""
    zero = splat16(_F(0.0))
    if axis == 0:
        return Vec3(zero, -d.z, d.y)
    if axis == 1:
        return Vec3(d.z, zero, -d.x)
    return Vec3(-d.y, d.x, zero)


@inlined
def _bound_plane(shafts, at, w, d, receivers, half, size):
    """Write the plane with normal w and the support of the two boxes."""
    store3(shafts, at, N, w)
    support = maximum(abs_dots(w, receivers), dot(w, d) + abs_dot(w, half))
    error = total(w) * _ROUNDING + _TINY
    store(shafts, at + 3 * N, support + absolute(support) * _F(2.0**-18) + error * size + _TINY)
    store(shafts, at + 4 * N, error)


@inlined
def invalidate_shafts(tile):
    """Mark the tile's shafts as outdated, because its receivers or samples are new."""
    put(tile.info, _MADE, _F(0.0))


@inlined
def ensure_shafts(tile):
    """Compute the shafts of a tile on first use. Many tiles meet no block and need none."""
    if get(tile.info, _MADE) == _F(0.0):
        make_shafts(tile.info, tile.groups, tile.shafts)
        put(tile.info, _MADE, _F(1.0))


@kernel
def make_shafts(info, groups, shafts):
    """Write the shafts of a tile to all groups, 16 at a time; `info` as in `tile.Tile`."""
    c, receivers = get3(info, 0, 1), get3(info, 3, 1)
    x1 = receivers.x + receivers.y + receivers.z
    dx = abs(_F(0.5) * (get(groups, 1) + get(groups, 3 * N + 1)) - c.x)
    dy = abs(_F(0.5) * (get(groups, N + 1) + get(groups, 4 * N + 1)) - c.y)
    dz = abs(_F(0.5) * (get(groups, 2 * N + 1) + get(groups, 5 * N + 1)) - c.z)
    along = 0 if dx >= dy and dx >= dz else (1 if dy >= dz else 2)
    for batch in range(0, N, 16):
        low, high = rows(groups, batch, N), rows(groups, 3 * N + batch, N)
        centre, half = middles_and_halves(low, high)
        d = Vec3(centre.x - c.x, centre.y - c.y, centre.z - c.z)
        d1, y1 = total(d), half.x + half.y + half.z
        twist = half.x * (receivers.y + receivers.z) + half.y * (receivers.x + receivers.z)
        span = d1 + (y1 + x1) * _F(2.0)
        store3(shafts, D + batch, N, d)
        store3(shafts, HALF + batch, N, half)
        store(shafts, TWIST + batch, twist + half.z * (receivers.x + receivers.y))
        store(shafts, SPAN + batch, span)
        store(shafts, LEVER + batch, d1 * x1)
        if batch == 16:
            o, start = Vec3(splat16(c.x), splat16(c.y), splat16(c.z)), receivers
            start = Vec3(splat16(start.x), splat16(start.y), splat16(start.z))
            store_reach(shafts, _REACHES, reach_of(o, d, start, half))
        inverse = splat16(_F(1.0)) / maximum(dot(d, d), splat16(_F(1e-30)))
        at = PLANES + batch
        for turn in (1, 2):
            m = _sideways(d, (along + turn) % 3)
            k = (abs_dot(m, half) - abs_dots(m, receivers)) * inverse
            back = Vec3(d.x * k, d.y * k, d.z * k)
            _bound_plane(shafts, at, Vec3(m.x - back.x, m.y - back.y, m.z - back.z), d, receivers, half, span)
            at += PLANE
            _bound_plane(shafts, at, Vec3(-m.x - back.x, -m.y - back.y, -m.z - back.z), d, receivers, half, span)
            at += PLANE


# --- Beams ------------------------------------------------------------------------------------------------------------


_D, _H, _BEAM_REACHES = 0, 48, 96
BEAM_FLOATS = _BEAM_REACHES + REACH_FLOATS


@inlined
def widened(d, half):
    """Half extents of the box at the end of d, widened to cover the rounding of d."""
    off = splat16(_F(2.0**-23))
    return Vec3(fma(absolute(d.x), off, half.x), fma(absolute(d.y), off, half.y), fma(absolute(d.z), off, half.z))


@kernel
def make_beams(tile):
    """Write the beams of a tile whose origins and targets are filled."""
    middle, half = rows(tile.targets, 0, 16), rows(tile.targets, 48, 16)
    o, zero = rows(tile.origins, 0, 16), splat16(_F(0.0))
    d = subtract3(middle, o)
    half = widened(d, half)
    store3(tile.beams, _D, 16, d)
    store3(tile.beams, _H, 16, half)
    store_reach(tile.beams, _BEAM_REACHES, reach_of(o, d, Vec3(zero, zero, zero), half))


@inlined
def beams_of(tile):
    """(directions to the centres of the boxes, half extents of the boxes)."""
    return rows(tile.beams, _D, 16), rows(tile.beams, _H, 16)


@inlined
def beam_of(tile, r):
    """`beams_of` for receiver r, in all lanes."""
    return broadcasts(tile.beams, _D + r, 16), broadcasts(tile.beams, _H + r, 16)


@inlined
def is_near(s, i, c):
    """True if beams are narrower than shafts of strata at a point. Towards the light, beams widen and shafts narrow.

    s, i : shafts and `info` of a `Tile`
    c : the point
    """
    dx, dy, dz = get(s, D + 1), get(s, D + N + 1), get(s, D + 2 * N + 1)
    along = (get(c, 0) - get(i, 0)) * dx + (get(c, 1) - get(i, 1)) * dy + (get(c, 2) - get(i, 2)) * dz
    light = get(s, HALF + 1) + get(s, HALF + N + 1) + get(s, HALF + 2 * N + 1)
    return along * light < (dx * dx + dy * dy + dz * dz - along) * (get(i, 3) + get(i, 4) + get(i, 5))


# --- Slab tests of segments -------------------------------------------------------------------------------------------


_PAD = _F(32 * 2.0**-24)
_LOW = _F(4 * 2.0**-24)
_SEGMENT_TINY = _F(1e-35)
_READY, _REACH, _ROWS = 0, 16, 32
"""int32: bits of the strata whose reciprocals are filled. float32: R per stratum, then three rows of reciprocals."""
INVERSE_FLOATS = _ROWS + POINTS


class Box(NamedTuple):
    """A box in all lanes."""

    middle: Vec3
    half: Vec3
    reach: F32x16  # at least the largest magnitude of a coordinate


@inlined
def box_at(bounds):
    """The `Box` of a block; bounds: pointer to its centre and half extents."""
    c, e = broadcasts(bounds, 0, 1), broadcasts(bounds, 4, 1)
    return Box(c, e, largest(c) + largest(e))


@inlined
def invalidate_inverses(tile):
    """Mark the tile's reciprocals as outdated, because its receivers or samples are new."""
    put(as_i32(tile.inverses), _READY, 0)


@inlined
def store_inverses(memory, at, o, l):
    """Write the reciprocals of 16 segments from o to l to three rows of `memory`. Return R."""
    reach = reduce_max(maximum(largest(o), largest(l)))
    low, d = splat16(reach * _LOW + _SEGMENT_TINY), subtract3(l, o)
    store(memory, at, _F(1.0) / select(absolute(d.x) > low + low, d.x, low))
    store(memory, at + 16, _F(1.0) / select(absolute(d.y) > low + low, d.y, low))
    store(memory, at + 32, _F(1.0) / select(absolute(d.z) > low + low, d.z, low))
    return reach


@kernel
def _fill_inverses(tile, s):
    """Write the reciprocals of the segments to stratum s."""
    reach = store_inverses(tile.inverses, _ROWS + 48 * s, rows(tile.origins, 0, 16), rows(tile.points, s * 48, 16))
    put(tile.inverses, _REACH + s, reach)
    ready = as_i32(tile.inverses)
    put(ready, _READY, get(ready, _READY) | 1 << s)


@inlined
def _span(c, o, inverse, e):
    """(entry t, exit t) of the slab of one axis."""
    t, grow = (c - o) * inverse, absolute(inverse)
    return fma(-e, grow, t), fma(e, grow, t)


@inlined
def rays_in_box(tile, s, box):
    """Bits of the receivers whose segment to stratum s meets a `Box`."""
    if get(as_i32(tile.inverses), _READY) >> s & 1 == 0:
        _fill_inverses(tile, s)
    inverse, reach = rows(tile.inverses, _ROWS + 48 * s, 16), broadcast16(tile.inverses, _REACH + s)
    return segments_in_box(rows(tile.origins, 0, 16), inverse, reach, box)


@inlined
def segments_in_box(o, inverse, reach, box):
    """Bits of the segments from o that meet a `Box`; inverse, reach: as `store_inverses` computes them."""
    c, pad = box.middle, fma(maximum(reach, box.reach), splat16(_PAD), splat16(_SEGMENT_TINY))
    x0, x1 = _span(c.x, o.x, inverse.x, box.half.x + pad)
    y0, y1 = _span(c.y, o.y, inverse.y, box.half.y + pad)
    z0, z1 = _span(c.z, o.z, inverse.z, box.half.z + pad)
    t_near, t_far = (
        maximum(maximum(x0, y0), maximum(z0, splat16(_F(0.0)))),
        minimum(minimum(x1, y1), minimum(z1, _F(1.0))),
    )
    return bits(t_near > t_far) ^ 0xFFFF


# --- Separating-axis tests --------------------------------------------------------------------------------------------


_SURE = _F(1e-35)
_ZERO, _ONE = _F(0.0), _F(1.0)


@inlined
def _in_box(m, v, e):
    """Bits of the segments along v that meet a box; m: its centre relative to their origins; e: its half extents."""
    half, tiny = _F(0.5), splat16(_TINY)
    d = Vec3(v.x * half, v.y * half, v.z * half)
    m = subtract3(m, d)
    n, h = magnitudes(m), magnitudes(d)
    meets = (n.x <= h.x + e.x) & (n.y <= h.y + e.y) & (n.z <= h.z + e.z)
    x = absolute(fma(m.y, d.z, -(m.z * d.y))) <= fma(e.y, h.z, fma(e.z, h.y, tiny))
    y = absolute(fma(m.z, d.x, -(m.x * d.z))) <= fma(e.z, h.x, fma(e.x, h.z, tiny))
    z = absolute(fma(m.x, d.y, -(m.y * d.x))) <= fma(e.x, h.y, fma(e.y, h.x, tiny))
    return bits(meets & x & y & z)


class Reach(NamedTuple):
    """What bounds the points of 16 shafts in a box, see `shafts_in_box`. It is the same for all boxes."""

    start: F32x16  # |v| . s
    inverse: F32x16  # reciprocal of v . v + |v| . (s - f); 0 if that is too small
    least: F32x16  # of t: 0, or 1 if `inverse` is 0
    size: F32x16  # at least the largest magnitude of a coordinate


@inlined
def reach_of(o, v, start_half, end_half):
    """The `Reach` of shafts from o along v; start_half, end_half: their half extents at the start and at the end."""
    size, square, zero, one = magnitudes(v), dot(v, v), splat16(_ZERO), splat16(_ONE)
    start = dot(size, start_half)
    length = square + (start - dot(size, end_half))
    sure = length > fma(square, splat16(_F(2.0**-8)), splat16(_SURE))
    return Reach(start, select(sure, one / length, zero), select(sure, zero, one), largest(o) + largest(v))


@inlined
def store_reach(memory, at, reach):
    """Write a `Reach` to REACH_FLOATS float32."""
    store(memory, at, reach.start)
    store(memory, at + 16, reach.inverse)
    store(memory, at + 32, reach.least)
    store(memory, at + 48, reach.size)


@inlined
def stored_reach(memory, at):
    """Load a `Reach`."""
    return Reach(load16(memory, at), load16(memory, at + 16), load16(memory, at + 32), load16(memory, at + 48))


@inlined
def shafts_in_box(o, v, start_half, end_half, reach, c, e):
    """Bits of the shafts from o along v that may meet the box with centre c and half extents e.

    With s = start_half and f = end_half, a point of the box has a parameter along the shaft of at most

        t = (|v| . e + |v| . s + v . (c - o)) / (v . v + |v| . (s - f))

    Up to t, the half extents of the shaft are at most s + t f.

    start_half, end_half : half extents of the shaft at its start and at its end
    reach : of the shafts
    """
    m, one = subtract3(c, o), splat16(_ONE)
    pad = fma(reach.size + largest(c), splat16(_PAD), splat16(_TINY))
    t = maximum((dot(m, v) + (dot(magnitudes(v), e) + reach.start)) * reach.inverse, reach.least)
    t = minimum(fma(t, splat16(_F(1.0 + 2.0**-10)), splat16(_F(2.0**-16))), one)
    width = add3(start_half, Vec3(t * end_half.x, t * end_half.y, t * end_half.z))
    return _in_box(m, v, Vec3(e.x + width.x + pad, e.y + width.y + pad, e.z + width.z + pad))


@inlined
def strata_in_box(tile, c, e):
    """Bits of the strata whose shafts may meet a box."""
    v, far, reach = rows(tile.shafts, D + 16, N), rows(tile.shafts, HALF + 16, N), stored_reach(tile.shafts, _REACHES)
    return shafts_in_box(broadcasts(tile.info, 0, 1), v, broadcasts(tile.info, 3, 1), far, reach, c, e)


@inlined
def beams_in_box(tile, c, e):
    """Bits of the receivers whose beams may meet a box."""
    v, far = beams_of(tile)
    zero, reach = splat16(_ZERO), stored_reach(tile.beams, _BEAM_REACHES)
    return shafts_in_box(rows(tile.origins, 0, 16), v, Vec3(zero, zero, zero), far, reach, c, e)
