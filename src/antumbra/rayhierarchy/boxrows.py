"""Triangle rows for the tests of `boxes`, one triangle at a time, in float64, for every kind of beam."""

import numpy as np

from ..kernels.jit import inlined, kernel
from .beams import AROUND, PERSPECTIVE
from .planes import nothing, sphere_of
from .rows import COVERS, INNER, OUTER, number, put_number, put_whole
from .view import turned

BOX, CORNERS = 32, 38
"""Positions in a row: the box of the triangle's shadow, and the farthest box corners along its outer planes."""

_E = np.float64(2.0**-19)  # exceeds the rounding error of planes, boxes and their products, for sums up to 1
_FAR = np.float64(2.0**-12)  # _FAR _E exceeds the relative rounding error of planes far from their corners
_TINY = np.float64(1e-30)  # exceeds the rounding error near the smallest float32 numbers
_INFINITE = np.float64(np.inf)
_SLANT = np.float64(1e-6)  # exceeds how far a receiver can lie beyond its face's edges, relative to its distance


@inlined
def _least(a, b):
    return a if a < b else b


@inlined
def _most(a, b):
    return a if a > b else b


@inlined
def lower(a, b):
    """The lower of two points on each axis."""
    return _least(a[0], b[0]), _least(a[1], b[1]), _least(a[2], b[2])


@inlined
def upper(a, b):
    """The higher of two points on each axis."""
    return _most(a[0], b[0]), _most(a[1], b[1]), _most(a[2], b[2])


@inlined
def _put_plane(row, at, plane, view, face, scale, sign):
    """Write a plane as (a, b, c, d), for f = a u + b v + c + d q, made a little larger (sign 1) or smaller (-1)."""
    size = abs(plane.x) + abs(plane.y) + abs(plane.z)
    s = 1.0 / size if size > 0.0 else np.float64(0.0)
    x, y, z, m = plane.x * s, plane.y * s, plane.z * s, plane.m * s
    if view.kind == PERSPECTIVE:
        a, b, c = turned((x, y, z), face)
        d = m + sign * _E * abs(m)
        c += sign * _E if s > 0.0 else np.float64(0.0)
    else:
        a, b, d = x, y, z
        c = m + sign * (_E * (abs(m) + scale) + _TINY) if s > 0.0 else np.float64(0.0)
    put_number(row, at, a)
    put_number(row, at + 1, b)
    put_number(row, at + 2, c)
    put_number(row, at + 3, d)


@inlined
def _corner(row, at, plane, ways):
    """Write which numbers of a node are the box corner farthest along a plane's normal."""
    put_whole(row, at, (1 if number(row, plane) > 0 else 0) * ways)
    put_whole(row, at + 1, (3 if number(row, plane + 1) > 0 else 2) * ways)
    put_whole(row, at + 2, (5 if number(row, plane + 3) > 0 else 4) * ways)


@inlined
def _shadow(x, z, r, low, high):
    """Extend (low, high) by a corner's shadow: by all (x - k y) / (z - k w) with |y|, |w| <= r and k <= 1."""
    near, far = 1.0 / (z - r), 1.0 / (z + r)
    low = _least(low, (x - r) * (near if x - r < 0.0 else far))
    return low, _most(high, (x + r) * (near if x + r > 0.0 else far))


@inlined
def _misses_face(corners, r):
    """Is a triangle beyond one of the planes that bound a face, or behind the apex? Corners are (u, v, depth)."""
    a, b, c, d, behind = True, True, True, True, True
    for u, v, z in corners:
        far = -_SLANT * (abs(u) + abs(v) + abs(z)) - 2.001 * r
        a, b, c, d = a and z - u < far, b and z + u < far, c and z - v < far, d and z + v < far
        behind = behind and z < far
    return a or b or c or d or behind


@inlined
def _perspective_box(view, face, corners):
    """(lower, upper, exists): the box in (u, v, q) of the triangle's shadow on a face, if there is one."""
    inf, r = _INFINITE, view.radius
    corners = turned(corners[0], face), turned(corners[1], face), turned(corners[2], face)
    if _misses_face(corners, r):
        return (inf, inf, inf), (-inf, -inf, -inf), False
    nearest = _least(_least(corners[0][2], corners[1][2]), corners[2][2])
    if not nearest > r * 1.000001 + 1e-30:
        return (-inf, -inf, -inf), (inf, inf, inf), True
    u0, u1, v0, v1 = inf, -inf, inf, -inf
    for u, v, z in corners:
        u0, u1 = _shadow(u, z, r, u0, u1)
        v0, v1 = _shadow(v, z, r, v0, v1)
    return (u0, v0, -inf), (u1, v1, 1.0 / (nearest - r)), True


@inlined
def _parallel_box(view, low, high):
    """(lower, upper): the box of the shadow for PARALLEL and AROUND beams, from the blocker's box."""
    if view.kind == AROUND:
        r = view.radius
        return (low[0] - r, low[1] - r, low[2] - r), (high[0] + r, high[1] + r, high[2] + r)
    if not view.radius < 0.999:
        return (-_INFINITE, -_INFINITE, -_INFINITE), (_INFINITE, _INFINITE, high[2])
    r = view.radius / np.sqrt(1.0 - view.radius * view.radius) * _most(high[2] - view.lowest, 0.0) * 1.000001
    return (low[0] - r, low[1] - r, -_INFINITE), (high[0] + r, high[1] + r, high[2])


@inlined
def _size(v):
    return abs(v[0]) + abs(v[1]) + abs(v[2])


@inlined
def _put_bounds(row, low, high, scale):
    for k in range(3):
        put_number(row, BOX + 2 * k, low[k] - (_E * (abs(low[k]) + scale) + _TINY))
        put_number(row, BOX + 2 * k + 1, high[k] + (_E * (abs(high[k]) + scale) + _TINY))


@kernel
def write_box_row(view, face, ways, shape, spheres, row):
    """Write the row of a triangle's `Shape` for a face; False if its shadow misses the face."""
    low, high = lower(lower(shape.a, shape.b), shape.c), upper(upper(shape.a, shape.b), shape.c)
    if spheres:  # only the sphere's box, no planes
        centre, r = sphere_of(shape)
        low, high = (centre[0] - r, centre[1] - r, centre[2] - r), (centre[0] + r, centre[1] + r, centre[2] + r)
    scale = np.float64(1.0)
    if view.kind == PERSPECTIVE:
        low, high, there = _perspective_box(view, face, (shape.a, shape.b, shape.c))
        if not there:
            return False
    else:
        scale = view.scale + _FAR * _most(_size(low), _size(high))
        low, high = _parallel_box(view, low, high)
    for k in range(4):
        outer = nothing() if spheres else shape.outer[k]
        _put_plane(row, OUTER + 4 * k, outer, view, face, scale, np.float64(1.0))
        _put_plane(row, INNER + 4 * k, shape.inner[k], view, face, scale, np.float64(-1.0))
        _corner(row, CORNERS + 3 * k, OUTER + 4 * k, ways)
    _put_bounds(row, low, high, scale)
    put_whole(row, COVERS, 1 if shape.covers else 0)
    return True
