"""Sorting keys of rays: the face of the cube and the place on a Hilbert curve over it, for 16 receivers at once.

An index on the discrete Hilbert curve has two bits for each level of subdivision [Olsson and Assarsson 2011, Sec. 3.5].
Float32 is precise enough: a ray that rounding moves across a face's edge sorts equally well there.
"""

import numpy as np

from ..kernels.jit import inlined
from ..kernels.simd import absolute, fma, maximum, minimum, select, splat16, to_i32

BITS = 14  # per coordinate; two coordinates and three bits for the face fill a non-negative int32
KEY_BITS = 2 * BITS + 3
_SIDE = np.float32(1 << BITS)
_LAST = np.int32((1 << BITS) - 1)
_F = np.float32


@inlined
def hilbert(x, y):
    """i32x16: indices on the curve of the cells (x, y), i32x16 of BITS bits each."""
    key = splat16(np.int32(0))
    for i in range(BITS - 1, -1, -1):
        a, b = (x >> i) & 1, (y >> i) & 1
        key = (key << 2) | ((a + a + a) ^ b)
        flip = -(a & (b ^ 1))  # all bits set where the quadrant is flipped
        x, y = x ^ flip, y ^ flip
        swap = (x ^ y) & (b - 1)  # the quadrant's axes swap
        x, y = x ^ swap, y ^ swap
    return key


@inlined
def _cells(u):
    """i32x16: cells of u in [0, 1)."""
    return minimum(maximum(to_i32(minimum(maximum(u, _F(0.0)), _F(1.0)) * _SIDE), np.int32(0)), _LAST)


@inlined
def on_cube(d):
    """(face, u, v) of directions from an apex, a `Vec` without zeros: i32x16, and twice f32x16 from 0 to 1."""
    x, y, z = absolute(d.x), absolute(d.y), absolute(d.z)
    by_x = (x >= y) & (x >= z)
    by_y = ~by_x & (y >= z)
    depth = select(by_x, d.x, select(by_y, d.y, d.z))
    u, v = select(by_x, d.y, select(by_y, d.z, d.x)), select(by_x, d.z, select(by_y, d.x, d.y))
    face = select(by_x, np.int32(0), select(by_y, splat16(np.int32(2)), splat16(np.int32(4))))
    face = face + select(depth < _F(0.0), splat16(np.int32(1)), splat16(np.int32(0)))
    half = _F(0.5)
    s = half / absolute(depth)
    return face, fma(u, s, half), fma(v, s, half)


@inlined
def cells_of(face, u, v):
    """i32x16: face and cell of (u, v), packed into one number; u and v are from 0 to 1."""
    return (((face << BITS) | _cells(u)) << BITS) | _cells(v)


@inlined
def keys_of(cells):
    """The sorting keys of packed cells: the face stays, a Hilbert index replaces the cell."""
    return (cells >> (2 * BITS) << (2 * BITS)) | hilbert((cells >> BITS) & _LAST, cells & _LAST)


@inlined
def on_ground(d, scale):
    """(face, u, v) of points for a beam that is not PERSPECTIVE: the face is 0, and scale maps u and v to [0, 1]."""
    return splat16(np.int32(0)), (d.x - scale.u) * scale.factor, (d.y - scale.v) * scale.factor
