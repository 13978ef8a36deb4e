"""Slab tests of a tile's segments against the box of a block, with reciprocals that are kept from block to block.

Let a segment lead from o along d. It is in the slab of a box with middle c and half extent e at t where
``|o + t d - c| <= e``, so between (c - o) / d - e / |d| and (c - o) / d + e / |d|. Let R be at least all magnitudes of
o, o + d and c -+ e, and u the unit roundoff.

- d is rounded, and a component below 8u R counts as 4u R. So it is wrong by at most 12u R, and for t up to 1 a point is
  as far off.
- (c - o) / d collects four roundings of at most 2R / |d|, and the sums with e / |d| collect less than 6u R / |d|.

e is widened by 32u R, which covers both. A quotient that overflows only leaves a segment in.
"""

from typing import NamedTuple

import numpy as np

from ..kernels.fields import F32x16
from ..kernels.jit import inlined, kernel
from ..kernels.simd import (
    absolute,
    as_i32,
    bits,
    broadcast16,
    fma,
    get,
    maximum,
    minimum,
    put,
    reduce_max,
    select,
    splat16,
    store,
)
from ..kernels.vec import Vec, broadcasts, largest, minus, rows
from .lighttable import POINTS

_F = np.float32
_PAD = _F(32 * 2.0**-24)
_LOW = _F(4 * 2.0**-24)
_TINY = _F(1e-35)
_READY, _REACH, _ROWS = 0, 16, 32
"""int32: bits of the strata whose numbers are filled. float32: R of each; then three rows of reciprocals of each."""
INVERSE_FLOATS = _ROWS + POINTS


class Box(NamedTuple):
    """A box in all lanes."""

    middle: Vec
    half: Vec
    reach: F32x16  # at least the largest magnitude of a coordinate


@inlined
def box_at(bounds):
    """The `Box` of a block; bounds: pointer to its middle and its half extents."""
    c, e = broadcasts(bounds, 0, 1), broadcasts(bounds, 4, 1)
    return Box(c, e, largest(c) + largest(e))


@inlined
def forget_inverses(tile):
    """Note that the tile's receivers or samples are new."""
    put(as_i32(tile.inverses), _READY, 0)


@inlined
def keep_inverses(memory, at, o, l):
    """Write the reciprocals of 16 segments from o to l to three rows of `memory`. Return R."""
    reach = reduce_max(maximum(largest(o), largest(l)))
    low, d = splat16(reach * _LOW + _TINY), minus(l, o)
    store(memory, at, _F(1.0) / select(absolute(d.x) > low + low, d.x, low))
    store(memory, at + 16, _F(1.0) / select(absolute(d.y) > low + low, d.y, low))
    store(memory, at + 32, _F(1.0) / select(absolute(d.z) > low + low, d.z, low))
    return reach


@kernel
def _fill_inverses(tile, s):
    """Write the reciprocals of the segments to stratum s."""
    reach = keep_inverses(tile.inverses, _ROWS + 48 * s, rows(tile.origins, 0, 16), rows(tile.points, s * 48, 16))
    put(tile.inverses, _REACH + s, reach)
    ready = as_i32(tile.inverses)
    put(ready, _READY, np.int64(get(ready, _READY)) | np.int64(1) << s)


@inlined
def _span(c, o, inverse, e):
    """(entry t, exit t) of the slab of one axis."""
    t, grow = (c - o) * inverse, absolute(inverse)
    return fma(-e, grow, t), fma(e, grow, t)


@inlined
def rays_in_box(tile, s, box):
    """Bits of the receivers whose segment to stratum s meets a `Box`."""
    if np.int64(get(as_i32(tile.inverses), _READY)) >> s & 1 == 0:
        _fill_inverses(tile, s)
    inverse, reach = rows(tile.inverses, _ROWS + 48 * s, 16), broadcast16(tile.inverses, _REACH + s)
    return segments_in_box(rows(tile.origins, 0, 16), inverse, reach, box)


@inlined
def segments_in_box(o, inverse, reach, box):
    """Bits of the segments from o that meet a `Box`; inverse, reach: as `keep_inverses` gives them."""
    c, pad = box.middle, fma(maximum(reach, box.reach), splat16(_PAD), splat16(_TINY))
    x0, x1 = _span(c.x, o.x, inverse.x, box.half.x + pad)
    y0, y1 = _span(c.y, o.y, inverse.y, box.half.y + pad)
    z0, z1 = _span(c.z, o.z, inverse.z, box.half.z + pad)
    near, far = maximum(maximum(x0, y0), maximum(z0, splat16(_F(0.0)))), minimum(minimum(x1, y1), minimum(z1, _F(1.0)))
    return bits(near > far) ^ 0xFFFF
