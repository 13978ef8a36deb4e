"""Separating-axis tests of a tile's shafts and beams against the box of a block.

The axes are the three axes of the box, and their cross products with the segments. A segment may meet the box if no
axis separates them. The middle of a segment and its distance from the box's middle are wrong by at most 4u of the
coordinates. `_PAD` covers this error eight times over. `_TINY` covers underflow. `_SURE` covers quotients of numbers
that underflow.
"""

import numpy as np

from ...kernels.jit import inlined
from ...kernels.simd import absolute, bits, fma, maximum, minimum, select, splat16
from ...kernels.vec import Vec, broadcasts, dot, largest, magnitudes, minus, plus, rows
from ..beams import beams_of
from ..shafts import HALF, D, N

_F = np.float32
_PAD = _F(32 * 2.0**-24)
_TINY = _F(1e-37)
_SURE = _F(1e-35)
_ZERO, _ONE = _F(0.0), _F(1.0)


@inlined
def _in_box(m, v, e):
    """Bits of the segments along v that meet a box. m: its middle relative to their starts; e: its half extents."""
    half, tiny = _F(0.5), splat16(_TINY)
    d = Vec(v.x * half, v.y * half, v.z * half)
    m = minus(m, d)
    n, h = magnitudes(m), magnitudes(d)
    meets = (n.x <= h.x + e.x) & (n.y <= h.y + e.y) & (n.z <= h.z + e.z)
    x = absolute(fma(m.y, d.z, -(m.z * d.y))) <= fma(e.y, h.z, fma(e.z, h.y, tiny))
    y = absolute(fma(m.z, d.x, -(m.x * d.z))) <= fma(e.z, h.x, fma(e.x, h.z, tiny))
    z = absolute(fma(m.x, d.y, -(m.y * d.x))) <= fma(e.x, h.y, fma(e.y, h.x, tiny))
    return bits(meets & x & y & z)


@inlined
def shafts_in_box(o, v, near, far, c, e):
    """Bits of the shafts from o along v that may meet the box with middle c and half extents e.

    A point of the box has a parameter along the shaft of at most

        t = (|v| . e + |v| . near + v . (c - o)) / (v . v + |v| . (near - far))

    Up to t the shaft is no wider than near + t far.

    near, far : half extents of the shaft at its start and at its end
    """
    m, size = minus(c, o), magnitudes(v)
    pad = fma(maximum(largest(o), largest(c)) + largest(v), splat16(_PAD), splat16(_TINY))
    start, square = dot(size, near), dot(v, v)
    reach, length = dot(m, v) + (dot(size, e) + start), square + (start - dot(size, far))
    t = select(length > fma(square, splat16(_F(2.0**-8)), splat16(_SURE)), reach / length, splat16(_ONE))
    t = minimum(fma(maximum(t, splat16(_ZERO)), splat16(_F(1.0 + 2.0**-10)), splat16(_F(2.0**-16))), splat16(_ONE))
    width = plus(near, Vec(t * far.x, t * far.y, t * far.z))
    return _in_box(m, v, Vec(e.x + width.x + pad, e.y + width.y + pad, e.z + width.z + pad))


@inlined
def strata_in_box(tile, c, e):
    """Bits of the strata whose shafts may meet a box."""
    v, far = rows(tile.shafts, D + 16, N), rows(tile.shafts, HALF + 16, N)
    return shafts_in_box(broadcasts(tile.info, 0, 1), v, broadcasts(tile.info, 3, 1), far, c, e)


@inlined
def beams_in_box(tile, c, e):
    """Bits of the receivers whose beams may meet a box."""
    v, far = beams_of(tile)
    zero = splat16(_ZERO)
    return shafts_in_box(rows(tile.origins, 0, 16), v, Vec(zero, zero, zero), far, c, e)
