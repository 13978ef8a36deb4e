"""Tests a triangle against cones: the precise test, the sphere test, and the test for covered cones.

The tests are those of [Olsson and Assarsson 2011, Sec. 3.2 and 3.3]. Let n be a unit vector, w and a the axis and
half-angle of a cone, and c = n . w. The largest extent of the cone along n, as a share of a ray's length, is

    cos(acos(c) - a) = c cos a + sqrt(1 - c^2) sin a

or 1 if n is in the cone, so planes are tested without a projection. The distances of Sec. 3.2 follow: -c / sin a is an
edge's distance from the centre of the unit circle. Tests are conservative: within the error bounds, a cone is possible.
"""

import numpy as np

from ...kernels.exact.filters import dot as dot3
from ...kernels.jit import inlined, kernel
from ...kernels.simd import absolute, bits, fma, load16, maximum, select, splat16, square_root
from ...kernels.vec3 import Vec3, dot, rows
from ...techniques.rayhierarchy.shadow_planes import (
    COVERS,
    INNER,
    OUTER,
    integer,
    number16,
    put_integer,
    put_number,
    sphere_of,
)

SPHERE, DIRECTIONS, EXACT = 32, 37, 46
"""Offsets in a row. SPHERE: the triangle's bounding sphere, with the unit vector to its centre, its radius relative to
the centre's distance, and the distance of its nearest point. DIRECTIONS: unit vectors to the corners. EXACT: whether
all rays end at the apex."""

_F = np.float32
_E = _F(2.0**-20)  # exceeds the rounding error of products of unit vectors
TINY = np.float64(1e-30)  # shorter vectors have no direction
_NEAR = _F(2.0**-10)  # corners closer to a cone's axis define no tangential plane


@inlined
def unit_of(v):
    """(v / |v|, |v|); a vector of zero length becomes 0."""
    length = np.sqrt(dot3(v, v))
    s = 1.0 / length if length > TINY else np.float64(0.0)
    return (v[0] * s, v[1] * s, v[2] * s), length


@inlined
def _put_plane(row, at, plane):
    """Write a plane with a unit normal."""
    n, length = unit_of((plane.x, plane.y, plane.z))
    put_number(row, at, n[0])
    put_number(row, at + 1, n[1])
    put_number(row, at + 2, n[2])
    put_number(row, at + 3, plane.m / length if length > TINY else 0.0)


@kernel
def write_cone_row(view, shape, row):
    """Write the row of a triangle's `Shape`. Return True, since this rejects no triangle."""
    corners = shape.a, shape.b, shape.c
    for k in range(4):
        _put_plane(row, OUTER + 4 * k, shape.outer[k])
        _put_plane(row, INNER + 4 * k, shape.inner[k])
    for k in range(3):
        d = unit_of(corners[k])[0]
        put_number(row, DIRECTIONS + 3 * k, d[0])
        put_number(row, DIRECTIONS + 3 * k + 1, d[1])
        put_number(row, DIRECTIONS + 3 * k + 2, d[2])
    centre, radius = sphere_of(shape)
    towards, far = unit_of(centre)
    for k in range(3):
        put_number(row, SPHERE + k, towards[k])
    put_number(row, SPHERE + 3, (radius + view.radius) / max(far, TINY))
    put_number(row, SPHERE + 4, far - (radius + view.radius) - _E * far)
    put_integer(row, EXACT, 1 if view.radius == 0.0 else 0)
    put_integer(row, COVERS, 1 if shape.covers else 0)
    return True


@inlined
def _along(group, ways, row, at):
    """f32x16: n . w for the vector n at offset `at` of a row."""
    y = fma(load16(group, ways), number16(row, at + 1), load16(group, 2 * ways) * number16(row, at + 2))
    return fma(load16(group, 0), number16(row, at), y)


@inlined
def _sine(c):
    """f32x16: an upper bound of sqrt(1 - c^2)."""
    return square_root(maximum(_F(1.0) - c * c, _F(0.0)) + _E)


@inlined
def _may_reach(group, ways, row, at):
    """mask16 of the cones with a possible ray end on the positive side of the outer plane at offset `at` of a row."""
    c, cos, sin = _along(group, ways, row, at), load16(group, 3 * ways), load16(group, 4 * ways)
    k = select(c >= cos - _E, splat16(_F(1.0)), fma(c, cos, _sine(c) * sin)) + _E
    m = number16(row, at + 3)
    length = select(k > _F(0.0), load16(group, 6 * ways), load16(group, 5 * ways))
    return ~(fma(k, length, fma(absolute(m), _E, m)) < _F(0.0))


@inlined
def _meets_sphere(group, ways, row):
    """mask16 of the cones that the sphere may intersect [Roger et al. 2007]."""
    z = _along(group, ways, row, SPHERE)
    x = number16(row, SPHERE) - z * load16(group, 0)
    y = number16(row, SPHERE + 1) - z * load16(group, ways)
    p = Vec3(x, y, number16(row, SPHERE + 2) - z * load16(group, 2 * ways))
    r, nearest = number16(row, SPHERE + 3), number16(row, SPHERE + 4)
    away = square_root(dot(p, p)) * load16(group, 3 * ways) - z * load16(group, 4 * ways)
    return (away <= r + _E) & (nearest <= load16(group, 6 * ways))


@inlined
def _beside(cos, sin, p, length, z, others, heights):
    """mask16 of the cones that the tangential plane towards a corner separates from all corners (Fig. 4b).

    p, z : the corner's direction, across the axis and along it
    others, heights : the same for all three corners
    """
    s = cos / length
    separated = (length > _NEAR) & (cos > _F(0.0))
    for k in range(3):
        separated = separated & (fma(dot(p, others[k]), s, -(sin * heights[k])) > _E)
    return separated


@inlined
def _in_shadow(group, ways, row):
    """mask16 of the cones that miss the triangle: separated by a tangential plane, or wide with the triangle outside.

    Distances from the edges alone do not reject cones in the "triangle shadow", near a corner. A cone wider than a
    half-space is the complement of a convex cone, and misses the triangle if all corners lie in this convex cone.
    """
    w, cos, sin = rows(group, 0, ways), load16(group, 3 * ways), load16(group, 4 * ways)
    at = DIRECTIONS
    z = _along(group, ways, row, at), _along(group, ways, row, at + 3), _along(group, ways, row, at + 6)
    p = _across(row, at, w, z[0]), _across(row, at + 3, w, z[1]), _across(row, at + 6, w, z[2])
    limit = cos - _E
    missed = (cos <= _F(0.0)) & (z[0] < limit) & (z[1] < limit) & (z[2] < limit)
    for k in range(3):
        missed = missed | _beside(cos, sin, p[k], square_root(dot(p[k], p[k])), z[k], p, z)
    return missed


@inlined
def _across(row, at, w, z):
    """`Vec3`: the component of a corner's direction perpendicular to the axes."""
    x, y = number16(row, at) - z * w.x, number16(row, at + 1) - z * w.y
    return Vec3(x, y, number16(row, at + 2) - z * w.z)


@inlined
def possible_cones(group, row, ways, alive, spheres):
    """Bits of the `alive` cones of a group with rays that the triangle may block."""
    if spheres:
        return bits(_meets_sphere(group, ways, row)) & alive
    possible = _may_reach(group, ways, row, OUTER) & _may_reach(group, ways, row, OUTER + 4)
    possible = bits(possible & _may_reach(group, ways, row, OUTER + 8) & _may_reach(group, ways, row, OUTER + 12))
    possible &= alive
    if possible != 0 and integer(row, EXACT) != 0:
        possible &= ~bits(_in_shadow(group, ways, row))
    return possible


@inlined
def _all_beyond(group, ways, row, at):
    """mask16 of the cones whose rays all end on the positive side of the inner plane at offset `at` (Sec. 3.3)."""
    c, cos, sin = _along(group, ways, row, at), load16(group, 3 * ways), load16(group, 4 * ways)
    k = fma(c, cos, -(_sine(c) * sin)) - _E
    narrow = (c > _F(0.0)) & (cos > _F(0.0)) & (k > _F(0.0))
    m = number16(row, at + 3)
    return narrow & (fma(k, load16(group, 5 * ways), fma(absolute(m), -_E, m)) > _F(0.0))


@inlined
def covered_cones(group, row, ways):
    """Bits of the cones whose rays are all blocked by the triangle (early accept, Sec. 3.3)."""
    if integer(row, COVERS) == 0:
        return np.int64(0)
    covered = _all_beyond(group, ways, row, INNER) & _all_beyond(group, ways, row, INNER + 4)
    return bits(covered & _all_beyond(group, ways, row, INNER + 8) & _all_beyond(group, ways, row, INNER + 12))
