"""Nodes as cones with a common apex, and the tests of a triangle against them [Olsson and Assarsson 2011].

A cone has a unit axis w and a half-angle a in [0, pi], and knows the shortest and the longest of its rays (Sec. 4.3).
With c = n . w the farthest that it goes along a unit vector n is cos(acos(c) - a) of a ray's length, c cos a +
sqrt(1 - c^2) sin a, or all of it if n is in the cone. So a plane is tested without a projection, and the distances of
Sec. 3.2 come out: -c / sin a is an edge's distance from the unit circle's centre. What rounding can cost is added to
the side of "perhaps".
"""

from typing import NamedTuple

import numpy as np
from numba.extending import overload

from ..jit import inlined, kernel
from ..simd import (
    absolute,
    bits,
    fma,
    get,
    load16,
    maximum,
    ptr,
    put,
    select,
    splat16,
    square_root,
)
from ..trace.vec import Vec, dot, rows
from . import nodes as names
from .planes import sphere_of
from .rows import COVERS, INNER, OUTER, number16, put_number, put_whole, whole
from .view import relative

ROWS = 7  # of a node: the axis, cos a, sin a, the shortest and the longest ray
SPHERE, DIRECTIONS, EXACT = 32, 37, 46
"""Where a row has the sphere around a triangle (unit vector to its centre, radius in units of the centre's distance,
distance of what is nearest in it), the unit vectors to the corners, and whether all rays end in the apex."""

_F = np.float32
_E = _F(2.0**-20)  # above the rounding of products of unit vectors
_MORE, _LESS = np.float64(1.0 + 2.0**-20), np.float64(1.0 - 2.0**-20)
_TINY = np.float64(1e-30)
_NEAR = _F(2.0**-10)  # a corner so near to a cone's axis is in it, or says nothing


class Cones(NamedTuple):
    """Nodes of a hierarchy; see `tree.Tree`."""

    numbers: np.ndarray

    ROWS = ROWS


@inlined
def _dot(a, b):
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@inlined
def _cross(a, b):
    return a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]


@inlined
def _unit(v):
    """(v / |v|, |v|); a vector of no length stays as it is."""
    length = np.sqrt(_dot(v, v))
    s = 1.0 / length if length > _TINY else np.float64(0.0)
    return (v[0] * s, v[1] * s, v[2] * s), length


@inlined
def _plus(a, b):
    return a[0] + b[0], a[1] + b[1], a[2] + b[2]


@inlined
def _wider(w, axis, c, s, cos, sin):
    """(c, s), cosine and sine of the largest angle so far to `w`, or of that to a cone around `axis`."""
    n = _cross(w, axis)
    across, along = np.sqrt(_dot(n, n)), _dot(w, axis)
    far, side = along * cos - across * sin, across * cos + along * sin
    if side < 0.0:  # more than all around
        return np.float64(-1.0), np.float64(0.0)
    return (far, side) if far < c else (c, s)


@inlined
def _put_cone(group, ways, lane, w, c, s, shortest, longest):
    """Write a cone, its angle and lengths a little larger."""
    for k in range(3):
        put(group, k * ways + lane, w[k])
    put(group, 3 * ways + lane, max(c - 2.0**-22 * (s + 2.0**-22), -1.0))
    put(group, 4 * ways + lane, min(s + 2.0**-22, 1.0) if c > -1.0 else 0.0)
    put(group, 5 * ways + lane, shortest * _LESS)
    put(group, 6 * ways + lane, longest * _MORE)


@inlined
def _ray_of(view, leaves, at):
    """(direction from the apex, length) of the ray whose receiver is at a place of a leaf."""
    p = leaves.origins
    x, y, z = get(p, at), get(p, at + leaves.ways), get(p, at + 2 * leaves.ways)
    return _unit(relative(view, (np.float64(x), np.float64(y), np.float64(z))))


@kernel
def _cone_of_leaf(view, leaves, leaf, group, lane):
    """The cone around the rays of a leaf."""
    ways, z = leaves.ways, np.float64(0.0)
    w, found = (z, z, z), False
    for i in range(ways):
        if get(leaves.ids, leaf * ways + i) >= 0:
            d, length = _ray_of(view, leaves, 3 * leaf * ways + i)
            w, found = _plus(w, d), True
    w = _unit(w)[0]
    if _dot(w, w) == 0.0:
        w = (np.float64(0.0), np.float64(0.0), np.float64(1.0))
    c, s, shortest, longest = np.float64(2.0), z, np.float64(np.inf), z
    for i in range(ways):
        if get(leaves.ids, leaf * ways + i) >= 0:
            d, length = _ray_of(view, leaves, 3 * leaf * ways + i)
            if length > _TINY:
                c, s = _wider(w, d, c, s, np.float64(1.0), z)
            else:
                c, s = np.float64(-1.0), z
            shortest, longest = min(shortest, length), max(longest, length)
    _put_cone(group, ways, lane, w, c, s, shortest, longest)
    return found


@inlined
def _axis(children, ways, i):
    w = get(children, i), get(children, ways + i), get(children, 2 * ways + i)
    return _unit((np.float64(w[0]), np.float64(w[1]), np.float64(w[2])))[0]


@inlined
def _angle(children, ways, i):
    """(cosine, sine) of the half-angle of a cone: from the smaller of the two, the other says little in float32."""
    cos, sin = np.float64(get(children, 3 * ways + i)), np.float64(get(children, 4 * ways + i))
    if cos > sin:
        return np.sqrt(1.0 - sin * sin), sin
    return cos, np.sqrt(max(1.0 - cos * cos, 0.0))


@kernel
def _cone_of_nodes(children, alive, ways, group, lane):
    """The cone around a group."""
    z = np.float64(0.0)
    w = (z, z, z)
    for i in range(ways):
        if alive >> i & 1:
            w = _plus(w, _axis(children, ways, i))
    w = _unit(w)[0]
    if _dot(w, w) == 0.0:
        w = (np.float64(0.0), np.float64(0.0), np.float64(1.0))
    c, s, shortest, longest = np.float64(2.0), z, np.float64(np.inf), z
    for i in range(ways):
        if alive >> i & 1:
            cos, sin = _angle(children, ways, i)
            c, s = _wider(w, _axis(children, ways, i), c, s, cos, sin)
            shortest = min(shortest, np.float64(get(children, 5 * ways + i)))
            longest = max(longest, np.float64(get(children, 6 * ways + i)))
    _put_cone(group, ways, lane, w, c, s, shortest, longest)


@inlined
def _put_plane(row, at, plane):
    """Write a plane with a unit normal."""
    n, length = _unit((plane.x, plane.y, plane.z))
    put_number(row, at, n[0])
    put_number(row, at + 1, n[1])
    put_number(row, at + 2, n[2])
    put_number(row, at + 3, plane.m / length if length > _TINY else 0.0)


@kernel
def _write_cone_row(view, shape, row):
    corners = shape.a, shape.b, shape.c
    for k in range(4):
        _put_plane(row, OUTER + 4 * k, shape.outer[k])
        _put_plane(row, INNER + 4 * k, shape.inner[k])
    for k in range(3):
        d = _unit(corners[k])[0]
        put_number(row, DIRECTIONS + 3 * k, d[0])
        put_number(row, DIRECTIONS + 3 * k + 1, d[1])
        put_number(row, DIRECTIONS + 3 * k + 2, d[2])
    centre, radius = sphere_of(shape)
    towards, far = _unit(centre)
    for k in range(3):
        put_number(row, SPHERE + k, towards[k])
    put_number(row, SPHERE + 3, (radius + view.radius) / max(far, _TINY))
    put_number(row, SPHERE + 4, far - (radius + view.radius) - _E * far)
    put_whole(row, EXACT, 1 if view.radius == 0.0 else 0)
    put_whole(row, COVERS, 1 if shape.covers else 0)
    return True


@inlined
def _along(group, ways, row, at):
    """f32x16: n . w of the vector at a place of a row."""
    y = fma(load16(group, ways), number16(row, at + 1), load16(group, 2 * ways) * number16(row, at + 2))
    return fma(load16(group, 0), number16(row, at), y)


@inlined
def _sine(c):
    """f32x16: at least sqrt(1 - c^2)."""
    return square_root(maximum(_F(1.0) - c * c, _F(0.0)) + _E)


@inlined
def _may_reach(group, ways, row, at):
    """mask16 of the cones that have a ray end where the outer plane at a place of a row is not negative."""
    c, cos, sin = _along(group, ways, row, at), load16(group, 3 * ways), load16(group, 4 * ways)
    k = select(c >= cos - _E, splat16(_F(1.0)), fma(c, cos, _sine(c) * sin)) + _E
    m = number16(row, at + 3)
    length = select(k > _F(0.0), load16(group, 6 * ways), load16(group, 5 * ways))
    return ~(fma(k, length, fma(absolute(m), _E, m)) < _F(0.0))


@inlined
def _meets_sphere(group, ways, row):
    """mask16 of the cones that the sphere may meet [Roger et al. 2007]."""
    z = _along(group, ways, row, SPHERE)
    x = number16(row, SPHERE) - z * load16(group, 0)
    y = number16(row, SPHERE + 1) - z * load16(group, ways)
    p = Vec(x, y, number16(row, SPHERE + 2) - z * load16(group, 2 * ways))
    r, nearest = number16(row, SPHERE + 3), number16(row, SPHERE + 4)
    away = square_root(dot(p, p)) * load16(group, 3 * ways) - z * load16(group, 4 * ways)
    return (away <= r + _E) & (nearest <= load16(group, 6 * ways))


@inlined
def _beside(cos, sin, p, length, z, others, heights):
    """mask16 of the cones that the tangential plane towards a corner parts from all corners (Fig. 4b).

    p, z : the corner's direction, across the axis and along it; others, heights: those of all three
    """
    s = cos / length
    found = (length > _NEAR) & (cos > _F(0.0))
    for k in range(3):
        found = found & (fma(dot(p, others[k]), s, -(sin * heights[k])) > _E)
    return found


@inlined
def _in_shadow(group, ways, row):
    """mask16 of the cones that a tangential plane parts from the triangle; or that leave it outside, if they are wide.

    The distances from the edges alone cannot tell cones in the "triangle shadow", near a corner. Cones wider than a
    half-space are the complement of one that is convex, and miss what has all corners in it.
    """
    w, cos, sin = rows(group, 0, ways), load16(group, 3 * ways), load16(group, 4 * ways)
    at = DIRECTIONS
    z = _along(group, ways, row, at), _along(group, ways, row, at + 3), _along(group, ways, row, at + 6)
    p = _across(row, at, w, z[0]), _across(row, at + 3, w, z[1]), _across(row, at + 6, w, z[2])
    limit = cos - _E
    found = (cos <= _F(0.0)) & (z[0] < limit) & (z[1] < limit) & (z[2] < limit)
    for k in range(3):
        found = found | _beside(cos, sin, p[k], square_root(dot(p[k], p[k])), z[k], p, z)
    return found


@inlined
def _across(row, at, w, z):
    """`Vec`: the part of a corner's direction that is at right angles to the axes."""
    x, y = number16(row, at) - z * w.x, number16(row, at + 1) - z * w.y
    return Vec(x, y, number16(row, at + 2) - z * w.z)


@inlined
def _possible_cones(group, row, ways, alive, spheres):
    if spheres:
        return bits(_meets_sphere(group, ways, row)) & alive
    found = _may_reach(group, ways, row, OUTER) & _may_reach(group, ways, row, OUTER + 4)
    found = bits(found & _may_reach(group, ways, row, OUTER + 8) & _may_reach(group, ways, row, OUTER + 12))
    found &= alive
    if found != 0 and whole(row, EXACT) != 0:
        found &= ~bits(_in_shadow(group, ways, row))
    return found


@inlined
def _all_beyond(group, ways, row, at):
    """mask16 of the cones whose rays all end where the inner plane at a place of a row is positive (Sec. 3.3)."""
    c, cos, sin = _along(group, ways, row, at), load16(group, 3 * ways), load16(group, 4 * ways)
    k = fma(c, cos, -(_sine(c) * sin)) - _E
    narrow = (c > _F(0.0)) & (cos > _F(0.0)) & (k > _F(0.0))
    m = number16(row, at + 3)
    return narrow & (fma(k, load16(group, 5 * ways), fma(absolute(m), -_E, m)) > _F(0.0))


@inlined
def _covered_cones(group, row, ways):
    if whole(row, COVERS) == 0:
        return np.int64(0)
    found = _all_beyond(group, ways, row, INNER) & _all_beyond(group, ways, row, INNER + 4)
    return bits(found & _all_beyond(group, ways, row, INNER + 8) & _all_beyond(group, ways, row, INNER + 12))


@overload(names.pointed)
def _pointed(nodes):
    if nodes.instance_class is Cones:
        return lambda nodes: Cones(ptr(nodes.numbers))


@overload(names.union_of)
def _union_of(nodes, block, lanes, union):
    if nodes.instance_class is Cones:
        return lambda nodes, block, lanes, union: False


@overload(names.meet_union)
def _meet_union(nodes, group, union, ways):
    if nodes.instance_class is Cones:
        return lambda nodes, group, union, ways: np.int64(0)


@overload(names.rows_of)
def _rows_of(nodes):
    if nodes.instance_class is Cones:
        return lambda nodes: ROWS


@overload(names.bound_leaf)
def _bound_leaf(nodes, view, face, leaves, leaf, group, lane):
    if nodes.instance_class is Cones:
        return lambda nodes, view, face, leaves, leaf, group, lane: _cone_of_leaf(view, leaves, leaf, group, lane)


@overload(names.bound_node)
def _bound_node(nodes, children, alive, ways, group, lane):
    if nodes.instance_class is Cones:
        return lambda nodes, children, alive, ways, group, lane: _cone_of_nodes(children, alive, ways, group, lane)


@overload(names.write_row)
def _write_row(nodes, view, face, ways, shape, spheres, row):
    if nodes.instance_class is Cones:
        return lambda nodes, view, face, ways, shape, spheres, row: _write_cone_row(view, shape, row)


@overload(names.writes_sixteen)
def _writes_sixteen(nodes):
    if nodes.instance_class is Cones:
        return lambda nodes: False


@overload(names.possible)
def _possible(nodes, group, row, ways, alive, spheres):
    if nodes.instance_class is Cones:
        return lambda nodes, group, row, ways, alive, spheres: _possible_cones(group, row, ways, alive, spheres)


@overload(names.covered)
def _covered(nodes, group, row, ways, among):
    if nodes.instance_class is Cones:
        return lambda nodes, group, row, ways, among: _covered_cones(group, row, ways) & among
