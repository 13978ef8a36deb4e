"""The beams of a tile: from each of its 16 receivers to the box of all of its samples.

These are the frusta of multi-frusta tracing [Benthin and Wald 2009], with one origin each. Next to the receivers they
are narrower than `shafts`, which start from the box of all receivers. Next to the light they are wider. Lanes are
receivers. Let D be the vector from the receiver to the middle of the box, and h the half extents of the box. Take the
edge functions of `multifrusta.shaftcull` along D. At a sample D + y they differ by y . N, so by at most h . |N|.
"""

import numpy as np

from ..kernels.jit import inlined, kernel
from ..kernels.simd import absolute, fma, get, splat16
from ..kernels.vec import Vec, broadcasts, keep, minus, rows
from .shafts import HALF, D, N

_F = np.float32
_D, _H = 0, 48
BEAM_FLOATS = 96


@inlined
def widened(d, half):
    """Half extents of the box at the end of d that cover the rounding of d."""
    off = splat16(_F(2.0**-23))
    return Vec(fma(absolute(d.x), off, half.x), fma(absolute(d.y), off, half.y), fma(absolute(d.z), off, half.z))


@kernel
def make_beams(tile):
    """Write the beams of a tile whose origins and targets are filled."""
    middle, half = rows(tile.targets, 0, 16), rows(tile.targets, 48, 16)
    d = minus(middle, rows(tile.origins, 0, 16))
    keep(tile.beams, _D, 16, d)
    keep(tile.beams, _H, 16, widened(d, half))


@inlined
def beams_of(tile):
    """(directions to the middles of the boxes, their half extents)."""
    return rows(tile.beams, _D, 16), rows(tile.beams, _H, 16)


@inlined
def beam_of(tile, r):
    """`beams_of` for receiver r, in all lanes."""
    return broadcasts(tile.beams, _D + r, 16), broadcasts(tile.beams, _H + r, 16)


@inlined
def is_near(s, i, c):
    """Are beams narrower than the shafts of strata at a point? Towards the light, beams widen and shafts narrow.

    s, i, c : the shafts of a `Tile`, its `info`, and the point
    """
    dx, dy, dz = get(s, D + 1), get(s, D + N + 1), get(s, D + 2 * N + 1)
    along = (get(c, 0) - get(i, 0)) * dx + (get(c, 1) - get(i, 1)) * dy + (get(c, 2) - get(i, 2)) * dz
    light = get(s, HALF + 1) + get(s, HALF + N + 1) + get(s, HALF + 2 * N + 1)
    return along * light < (dx * dx + dy * dy + dz * dz - along) * (get(i, 3) + get(i, 4) + get(i, 5))
