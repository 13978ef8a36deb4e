"""The planes of a triangle's shadow in a beam, and the rows of triangle data for node tests, 16 triangles at a time.

Planes. A triangle blocks the segment from a receiver O to an end L if O and L are on different sides of its plane, and
O is on the triangle's side of the three planes through L and an edge. Since a node has many receivers, and a beam may
have many ends, there are two sets of planes f(x) = n . x + m, each with three edge planes and the triangle's own:

*outer*
    No end has f > 0, and no point of the triangle has f < 0. A segment from a receiver with f < 0 misses the triangle.
*inner*
    No end has f < 0 (for the triangle's own plane: f > 0). A segment from a receiver with all f > 0 meets the triangle.

For a point light, both sets are the planes of Sec. 3.2 [Olsson and Assarsson 2011], which contain the apex, and the
paper's distances of cones from the edges are values of f. For a ball, the planes are tangent to it. For directions in a
cone, they are tilted by its angle. Let b be the normal of the plane through the apex and the edge P + s t. The tangent
plane through the edge has the normal n = (r / h) p +- sqrt(1 - r^2 / h^2) b, where h is the distance of the edge's line
from the apex, p the unit vector to its nearest point and r the ball's radius.

Rows. The numbers of a triangle are 16 apart, so that 16 triangles can be written at once and each one read separately.
"""

from typing import NamedTuple, TypeAlias

import numpy as np

from ...kernels.exact.filters import cross, dot
from ...kernels.jit import inlined, kernel
from ...kernels.simd import as_i32, broadcast16, get, put
from .light_beams import AROUND, PERSPECTIVE

# --- Rows of triangle data --------------------------------------------------------------------------------------------

LANES = 16
NUMBERS = 56
"""Numbers per triangle. The first 16 are the four outer planes, by which tests reject nodes."""

OUTER, INNER, TRIANGLE, COVERS = 0, 16, 54, 55
"""Positions of the outer planes, inner planes, soup index, and whether all inner planes are known.

The modules that write rows define the other positions."""

BLOCK = NUMBERS * LANES
"""Numbers of 16 triangles."""


@inlined
def number(row, k):
    """Number k of a triangle; row: pointer to its first number."""
    return get(row, LANES * k)


@inlined
def number16(row, k):
    """Number k of a triangle, in all lanes."""
    return broadcast16(row, LANES * k)


@inlined
def put_number(row, k, x):
    """Write number k of a triangle."""
    put(row, LANES * k, x)


@inlined
def integer(row, k):
    """Number k of a triangle, read as an int32."""
    return get(as_i32(row), LANES * k)


@inlined
def put_integer(row, k, x):
    """Write number k of a triangle as an int32."""
    put(as_i32(row), LANES * k, x)


# --- Shadow planes ----------------------------------------------------------------------------------------------------

_MORE = np.float64(1.0 + 2.0**-20)
_U = np.float64(
    2.0**-28
)  # relative to the summed products; a smaller side is unknown, because rounding turns its plane
_THIN = np.float64(2.0**-22)  # relative to a triangle's length: no plane at h = _U has a certain side below it
_COORDINATES = np.float64(2.0**-22)  # 2^-50 / _U: exceeds the relative rounding error of coordinates


class ShadowPlane(NamedTuple):
    """n . x + m in the beam's frame, float64; n = 0 and m = 0: the plane is unknown."""

    x: float
    y: float
    z: float
    m: float


Point: TypeAlias = tuple[float, float, float]
Planes: TypeAlias = tuple[ShadowPlane, ShadowPlane, ShadowPlane, ShadowPlane]


class Shape(NamedTuple):
    """A triangle in the frame of a beam, with its shadow planes."""

    a: Point  # corners in the beam's frame, float64
    b: Point
    c: Point
    outer: Planes  # four planes: of the edges ab, bc, ca and of the triangle
    inner: Planes  # four planes, in the same order
    covers: bool  # whether all inner planes are known
    facing: int  # 1 or -1: sign of d . n of the segments that hit it; 0: unknown


@inlined
def unknown_plane():
    """The unknown plane, which never decides a test."""
    z = np.float64(0.0)
    return ShadowPlane(z, z, z, z)


@inlined
def minus(a, b):
    """a - b of tuples of three numbers."""
    return a[0] - b[0], a[1] - b[1], a[2] - b[2]


@inlined
def _plane_at(n, p):
    return ShadowPlane(n[0], n[1], n[2], -dot(n, p))


@inlined
def _through_apex(t, w, r):
    """(plane, known): the plane through the apex and an edge along t with the point w; positive at the point r."""
    n = cross(t, w)
    side = dot(n, r)
    size = abs(t[0]) + abs(t[1]) + abs(t[2])
    far = (abs(w[0]) + abs(w[1]) + abs(w[2])) * (abs(r[0]) + abs(r[1]) + abs(r[2]))
    if not abs(side) > _U * size * far:
        return unknown_plane(), False
    s = np.float64(1.0) if side > 0.0 else np.float64(-1.0)
    return ShadowPlane(s * n[0], s * n[1], s * n[2], np.float64(0.0)), True


@kernel
def _tangent(t, w, p, r, radius):
    """(plane, known): the plane through the edge p + s t with n . (foot of w) = radius; it is positive at the point r.

    radius > 0: an outer plane; radius < 0: an inner plane.
    """
    zero = np.float64(0.0)
    length = np.sqrt(dot(t, t))
    if not length > zero:
        return unknown_plane(), False
    t = t[0] / length, t[1] / length, t[2] / length
    along = dot(w, t)
    foot = w[0] - along * t[0], w[1] - along * t[1], w[2] - along * t[2]
    h = np.sqrt(dot(foot, foot))
    if not h > abs(radius) * 1.000001 + _U * np.sqrt(dot(w, w)):
        return unknown_plane(), False
    k = radius / (h * h)
    b = cross(t, foot)
    c = np.sqrt(np.float64(1.0) - (radius / h) * (radius / h)) / h
    to = minus(r, p)
    size = abs(to[0]) + abs(to[1]) + abs(to[2])
    for sign in (np.float64(1.0), np.float64(-1.0)):
        n = k * foot[0] + sign * c * b[0], k * foot[1] + sign * c * b[1], k * foot[2] + sign * c * b[2]
        other = k * foot[0] - sign * c * b[0], k * foot[1] - sign * c * b[1], k * foot[2] - sign * c * b[2]
        if dot(n, to) > _THIN * size and (not dot(other, to) > _THIN * size or dot(n, to) > dot(other, to)):
            return _plane_at(n, p), True
    return unknown_plane(), False


@inlined
def _own_plane(view, a, b, c):
    """(plane, facing): the triangle's own plane, negative on the light's side; facing 0: unknown."""
    n = cross(minus(b, a), minus(c, a))
    p = abs(b[0] - a[0]) + abs(b[1] - a[1]) + abs(b[2] - a[2])
    q = abs(c[0] - a[0]) + abs(c[1] - a[1]) + abs(c[2] - a[2])
    far = abs(a[0]) + abs(a[1]) + abs(a[2])
    if view.kind == PERSPECTIVE:
        d, size = dot(n, a), far
    else:
        d, size = -n[2], np.float64(1.0)
    slack = view.radius * np.sqrt(dot(n, n)) * 1.000001 + _U * size * (p * q + _COORDINATES * far * (p + q))
    if d > slack:
        return ShadowPlane(n[0], n[1], n[2], -dot(n, a)), -1
    if -d > slack:
        return ShadowPlane(-n[0], -n[1], -n[2], dot(n, a)), 1
    return unknown_plane(), 0


@inlined
def _edge(view, p, q, r):
    """(outer plane, inner plane, both known) of the edge from p to q; r is the third corner."""
    if dot(q, q) < dot(p, p):  # start at the nearer end, because the rounding error grows with its distance
        p, q = q, p
    t, w = minus(q, p), p
    if view.radius == 0.0:  # a point light; all other beams have a radius
        plane, known = _through_apex(t, p, r)
        return plane, plane, known
    if view.kind != PERSPECTIVE:
        w = np.float64(0.0), np.float64(0.0), np.float64(-1.0)
    outer, met = _tangent(t, w, p, r, view.radius)
    inner, known = _tangent(t, w, p, r, -view.radius)
    return outer, inner, met and known


@inlined
def shape_of(view, a, b, c):
    """The `Shape` of the triangle with these corners, float64, in the beam's frame."""
    if view.kind == AROUND:  # segments have all directions, so no plane is known
        none = unknown_plane(), unknown_plane(), unknown_plane(), unknown_plane()
        return Shape(a, b, c, none, none, False, 0)
    plane, facing = _own_plane(view, a, b, c)
    outer0, inner0, known0 = _edge(view, a, b, c)
    outer1, inner1, known1 = _edge(view, b, c, a)
    outer2, inner2, known2 = _edge(view, c, a, b)
    outer, inner = (outer0, outer1, outer2, plane), (inner0, inner1, inner2, plane)
    return Shape(a, b, c, outer, inner, known0 and known1 and known2 and facing != 0, np.int64(facing))


@inlined
def _distance(a, b):
    d = minus(a, b)
    return np.sqrt(dot(d, d))


@inlined
def sphere_of(shape):
    """(centre, radius) of a sphere around the triangle, centred at the middle of its longest edge."""
    a, b, c = shape.a, shape.b, shape.c
    ab, bc, ca = _distance(a, b), _distance(b, c), _distance(c, a)
    p, q, r = (a, b, c) if ab >= bc and ab >= ca else ((b, c, a) if bc >= ca else (c, a, b))
    middle = 0.5 * (p[0] + q[0]), 0.5 * (p[1] + q[1]), 0.5 * (p[2] + q[2])
    return middle, max(_distance(p, middle), max(_distance(q, middle), _distance(r, middle))) * _MORE
