"""What a triangle blocks of a beam, as planes that nodes of rays are tested against.

A triangle blocks the segment from a receiver O to an end L if the two are on different sides of its plane and on the
same side as the triangle of the three planes through its edges and L. A node has many receivers, and a beam may have
many ends, so there are two sets of planes f(x) = n . x + m, each with three through the edges and the triangle's own:

*outer*
    no end is where f > 0, and the triangle is not where f < 0. Segments from where f < 0 do not meet the triangle.
*inner*
    no end is where f < 0 (for the triangle's own plane: where f > 0). Segments from where all f > 0 meet the triangle.

For a point both are the planes of Sec. 3.2 [Olsson and Assarsson 2011], which hold the apex; its cones' distances from
the edges are f there. For a ball they are tangent to it, for directions in a cone tilted by its angle: if the edge's
plane through the apex has the normal b, that through the edge P + s t has n = (r / h) p +- sqrt(1 - r^2 / h^2) b, with
h the distance of the edge's line from the apex, p the unit vector to its nearest point and r the ball's radius.
"""

from typing import NamedTuple

import numpy as np

from ..kernels.jit import inlined, kernel
from ..kernels.predicate.filters import cross, dot
from .beams import AROUND, PERSPECTIVE

_MORE = np.float64(1.0 + 2.0**-20)
_U = np.float64(2.0**-28)  # what is less, in units of the products that it sums, says nothing: rounding turns its plane
_THIN = np.float64(2.0**-22)  # of a triangle in units of its length: no side of a plane at h = _U has less for sure
_COORDINATES = np.float64(2.0**-22)  # 2^-50 / _U: above the rounding of coordinates, in units of them


class ShadowPlane(NamedTuple):
    """n . x + m in the beam's frame, float64; n = 0: says nothing, as m is 0 then."""

    x: float
    y: float
    z: float
    m: float


class Shape(NamedTuple):
    """A triangle seen along a beam."""

    a: tuple  # corners in the beam's frame, float64
    b: tuple
    c: tuple
    outer: tuple  # four planes: of the edges ab, bc, ca and of the triangle
    inner: tuple
    covers: bool  # do the inner planes hold?
    facing: int  # 1 or -1: sign of d . n of the segments that meet it; 0: not known


@inlined
def nothing():
    """The plane that says nothing."""
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
    """The plane through an edge along t with the point w and the apex, with the point r where it is positive:
    (plane, known)."""
    n = cross(t, w)
    side = dot(n, r)
    size = abs(t[0]) + abs(t[1]) + abs(t[2])
    far = (abs(w[0]) + abs(w[1]) + abs(w[2])) * (abs(r[0]) + abs(r[1]) + abs(r[2]))
    if not abs(side) > _U * size * far:
        return nothing(), False
    s = np.float64(1.0) if side > 0.0 else np.float64(-1.0)
    return ShadowPlane(s * n[0], s * n[1], s * n[2], np.float64(0.0)), True


@kernel
def _tangent(t, w, p, r, radius):
    """The plane through the edge p + s t, with n . (foot of w) = radius and the point r where it is positive:
    (plane, known). radius > 0: an outer plane, < 0: an inner one."""
    zero = np.float64(0.0)
    length = np.sqrt(dot(t, t))
    if not length > zero:
        return nothing(), False
    t = t[0] / length, t[1] / length, t[2] / length
    along = dot(w, t)
    foot = w[0] - along * t[0], w[1] - along * t[1], w[2] - along * t[2]
    h = np.sqrt(dot(foot, foot))
    if not h > abs(radius) * 1.000001 + _U * np.sqrt(dot(w, w)):
        return nothing(), False
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
    return nothing(), False


@inlined
def _own_plane(view, a, b, c):
    """(plane, facing): the triangle's own, negative where the light is; facing 0: it is not known where that is."""
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
    return nothing(), 0


@inlined
def _edge(view, p, q, r):
    """(outer plane, inner plane, are both known?) of the edge from p to q; r is the third corner."""
    if dot(q, q) < dot(p, p):  # what rounding costs grows with the distance of the end that the plane is drawn from
        p, q = q, p
    t, w = minus(q, p), p
    if view.radius == 0.0:  # of a point; other beams have some
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
    if view.kind == AROUND:  # segments go everywhere, so planes tell nothing
        none = nothing(), nothing(), nothing(), nothing()
        return Shape(a, b, c, none, none, False, np.int64(0))
    own, facing = _own_plane(view, a, b, c)
    outer0, inner0, known0 = _edge(view, a, b, c)
    outer1, inner1, known1 = _edge(view, b, c, a)
    outer2, inner2, known2 = _edge(view, c, a, b)
    outer, inner = (outer0, outer1, outer2, own), (inner0, inner1, inner2, own)
    return Shape(a, b, c, outer, inner, known0 and known1 and known2 and facing != 0, np.int64(facing))


@inlined
def _distance(a, b):
    d = minus(a, b)
    return np.sqrt(dot(d, d))


@inlined
def sphere_of(shape):
    """(centre, radius) of a sphere around the triangle: at the middle of its longest edge."""
    a, b, c = shape.a, shape.b, shape.c
    ab, bc, ca = _distance(a, b), _distance(b, c), _distance(c, a)
    p, q, r = (a, b, c) if ab >= bc and ab >= ca else ((b, c, a) if bc >= ca else (c, a, b))
    middle = 0.5 * (p[0] + q[0]), 0.5 * (p[1] + q[1]), 0.5 * (p[2] + q[2])
    return middle, max(_distance(p, middle), max(_distance(q, middle), _distance(r, middle))) * _MORE
