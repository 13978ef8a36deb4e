"""Vectors of three coordinates: float32 scalars, or f32x16 with one vector per lane."""

from typing import NamedTuple

import numpy as np

from .jit import F32OrLanes, inlined
from .simd import absolute, broadcast16, fma, get, load16, maximum, select, splat16, store

_HALF, _MORE = np.float32(0.5), np.float32(1.0 + 2.0**-18)


class Vec3(NamedTuple):
    """Three coordinates: float32 or f32x16."""

    x: F32OrLanes
    y: F32OrLanes
    z: F32OrLanes


@inlined
def dot(a, b):
    """a . b for f32x16."""
    return fma(a.x, b.x, fma(a.y, b.y, a.z * b.z))


@inlined
def dots(v, s):
    """v . s for f32x16 and scalars."""
    return fma(v.x, splat16(s.x), fma(v.y, splat16(s.y), v.z * s.z))


@inlined
def abs_dot(v, w):
    """|v| . w for f32x16, with |v| componentwise."""
    return fma(absolute(v.x), w.x, fma(absolute(v.y), w.y, absolute(v.z) * w.z))


@inlined
def abs_dots(v, s):
    """|v| . s for f32x16 and scalars, with |v| componentwise."""
    return fma(absolute(v.x), splat16(s.x), fma(absolute(v.y), splat16(s.y), absolute(v.z) * s.z))


@inlined
def cross(a, b):
    """a x b for f32x16."""
    return Vec3(fma(a.y, b.z, -(a.z * b.y)), fma(a.z, b.x, -(a.x * b.z)), fma(a.x, b.y, -(a.y * b.x)))


@inlined
def crosses(a, s):
    """a x s for f32x16 and scalars."""
    return Vec3(
        fma(a.y, splat16(s.z), -(a.z * s.y)),
        fma(a.z, splat16(s.x), -(a.x * s.z)),
        fma(a.x, splat16(s.y), -(a.y * s.x)),
    )


@inlined
def add3(a, b):
    """The sum of two vectors."""
    return Vec3(a.x + b.x, a.y + b.y, a.z + b.z)


@inlined
def subtract3(a, b):
    """The difference of two vectors."""
    return Vec3(a.x - b.x, a.y - b.y, a.z - b.z)


@inlined
def scale3(a, s):
    """a * s, componentwise."""
    return Vec3(a.x * s, a.y * s, a.z * s)


@inlined
def largest(v):
    """The largest magnitude of three f32x16."""
    return maximum(maximum(absolute(v.x), absolute(v.y)), absolute(v.z))


@inlined
def magnitudes(v):
    """The magnitude of each component."""
    return Vec3(absolute(v.x), absolute(v.y), absolute(v.z))


@inlined
def total(v):
    """The sum of magnitudes of three f32x16."""
    return absolute(v.x) + absolute(v.y) + absolute(v.z)


@inlined
def middles_and_halves(low, high):
    """(middles, half extents) of boxes from their corners, padded so that middle -+ half contains each box."""
    m = add3(scale3(low, _HALF), scale3(high, _HALF))
    up, down = subtract3(high, m), subtract3(m, low)
    return m, Vec3(maximum(up.x, down.x) * _MORE, maximum(up.y, down.y) * _MORE, maximum(up.z, down.z) * _MORE)


@inlined
def splats(v):
    """Three scalars, each in all lanes."""
    return Vec3(splat16(v.x), splat16(v.y), splat16(v.z))


@inlined
def select3(mask, a, b):
    """Lanes of a where the mask is set, of b where it is not."""
    return Vec3(select(mask, a.x, b.x), select(mask, a.y, b.y), select(mask, a.z, b.z))


@inlined
def get3(p, at, stride):
    """Load three numbers, `stride` apart."""
    return Vec3(get(p, at), get(p, at + stride), get(p, at + 2 * stride))


@inlined
def rows(p, at, stride):
    """Load three f32x16, `stride` float32 apart."""
    return Vec3(load16(p, at), load16(p, at + stride), load16(p, at + 2 * stride))


@inlined
def broadcasts(p, at, stride):
    """Load three numbers, `stride` apart, each into all lanes."""
    return Vec3(broadcast16(p, at), broadcast16(p, at + stride), broadcast16(p, at + 2 * stride))


@inlined
def store3(p, at, stride, v):
    """Store three f32x16, `stride` float32 apart."""
    store(p, at, v.x)
    store(p, at + stride, v.y)
    store(p, at + 2 * stride, v.z)
