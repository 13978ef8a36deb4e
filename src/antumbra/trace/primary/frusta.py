"""Slab tests of the 16 frusta of a tile of primary rays: 8 x 4 pixels each, the camera as common origin.

A frustum contains the rays o + t d of its pixels. Along each axis d_low <= d <= d_high. So a frustum is an endless
shaft (`trace.slabs`) [Benthin and Wald 2009, Sec. 4.1].
"""

import numpy as np

from ...kernels.jit import inlined, kernel
from ...kernels.simd import put, splat16
from ...kernels.vec import rows
from ..descent import endless_slabs_of
from ..slabs import Shafts

_LOW, _HIGH = 0, 48  # rows of 16: d_low (x, y, z), d_high
FLOATS = 96


@kernel
def bound_directions(rays, error, x0, y0, directions):
    """Write d_low and d_high of the frusta of the tile at pixel (x0, y0).

    Frusta beyond the picture are bounded, too.

    error : (3,) float64, bound of the error of `pixel_direction`
    """
    for axis in range(3):
        dx, dy = rays.dx[axis], rays.dy[axis]
        half = 3.5 * abs(dx) + 1.5 * abs(dy) + 2.0 * error[axis]
        for f in range(16):
            middle = rays.corner[axis] + (x0 + 8 * (f & 3) + 4.0) * dx + (y0 + 4 * (f >> 2) + 2.0) * dy
            put(directions, _LOW + 16 * axis + f, middle - half)
            put(directions, _HIGH + 16 * axis + f, middle + half)


@inlined
def slabs_from(eye, directions):
    """`Slabs` of the 16 frusta."""
    x, y, z = splat16(np.float32(eye.x)), splat16(np.float32(eye.y)), splat16(np.float32(eye.z))
    low, high = rows(directions, _LOW, 16), rows(directions, _HIGH, 16)
    shafts = Shafts(x, y, z, x, y, z, low.x, low.y, low.z, high.x, high.y, high.z)
    return endless_slabs_of(shafts, np.int64(0xFFFF))
