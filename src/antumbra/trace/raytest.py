"""One triangle against 16 rays in float32, which decides only beyond the bounds of `predicate.filters`."""

from typing import NamedTuple

import numpy as np

from ..jit import inlined
from ..simd import bits, fma, get, maximum, minimum, splat16
from .vec import Vec, crosses, dot, dots, largest, total

_F = np.float32
_U = _F(64 * 2.0**-24)
_TINY = _F(1e-37)


class Triangle(NamedTuple):
    """A triangle's first corner, the edges at it, their cross product and their largest component; float32 scalars."""

    v: Vec
    p: Vec
    q: Vec
    n: Vec
    size: float


class Lanes(NamedTuple):
    """A triangle as the origins of 16 rays see it; f32x16."""

    cp: Vec  # a x p, where a = v0 - origin
    cq: Vec  # a x q
    n: Vec
    t: object  # a . n
    e: object  # bounds of the errors of the three edge functions,
    te: object  # of t and of the distance of the ray's end from the plane


@inlined
def _wider(size, v):
    x, y, z = abs(v.x), abs(v.y), abs(v.z)
    size = x if x > size else size
    size = y if y > size else size
    return z if z > size else size


@inlined
def triangle_along(v, p, q):
    """The `Triangle` of a corner and its two edges."""
    n = Vec(p.y * q.z - p.z * q.y, p.z * q.x - p.x * q.z, p.x * q.y - p.y * q.x)
    return Triangle(v, p, q, n, _wider(_wider(_F(0.0), p), q))


@inlined
def triangle_in(corners, slot):
    """The `Triangle` in a slot of a BVH's corners."""
    k = slot * 9
    v = Vec(get(corners, k), get(corners, k + 1), get(corners, k + 2))
    p = Vec(get(corners, k + 3) - v.x, get(corners, k + 4) - v.y, get(corners, k + 5) - v.z)
    q = Vec(get(corners, k + 6) - v.x, get(corners, k + 7) - v.y, get(corners, k + 8) - v.z)
    return triangle_along(v, p, q)


@inlined
def splats(v):
    """Three scalars, each in all lanes."""
    return Vec(splat16(v.x), splat16(v.y), splat16(v.z))


@inlined
def seen_from(origins, span, triangle):
    """`Lanes` of a triangle for 16 origins; `span`: at least the sum of the components of any of their rays, f32x16."""
    a = Vec(triangle.v.x - origins.x, triangle.v.y - origins.y, triangle.v.z - origins.z)
    reach, size, n = largest(a), triangle.size, triangle.n
    wide = maximum(reach, splat16(size))
    floor = fma(wide + span, splat16(_TINY), splat16(_TINY))
    e = fma(wide * span, splat16(size * _U), floor)
    te = fma(reach + span, splat16(size * size * _U), floor)
    return Lanes(crosses(a, triangle.p), crosses(a, triangle.q), splats(n), dots(a, n), e, te)


@inlined
def length1(d):
    """Sum of the components' magnitudes, rounded up."""
    return total(d) * _F(1.0 + 2.0**-21)


@inlined
def decide(d, lanes, facing):
    """(bits of the rays along d that surely meet the triangle, of those float32 cannot say)."""
    e2, e1, dn, e, te = dot(d, lanes.cp), -dot(d, lanes.cq), dot(d, lanes.n), lanes.e, lanes.te
    e0, f = dn - e1 - e2, lanes.t - dn
    low, high = minimum(minimum(e0, e1), e2), maximum(maximum(e0, e1), e2)
    near, far = minimum(lanes.t, f), maximum(lanes.t, f)
    miss = ((low < -e) & (high > e)) | (near > te) | (far < -te)
    left = bits(miss) ^ 0xFFFF
    if left == 0:
        return left, left
    up, down = low > e, high < -e
    crosses_plane = (near < -te) & (far > te)
    hit = bits((up | down) & crosses_plane)
    if facing != 0:
        wrong = bits(up) if facing > 0 else bits(down)
        return hit & ~wrong, left & ~hit & ~wrong
    return hit, left & ~hit
