"""Nodes as boxes in the beam's projection: our own, tighter and cheaper than cones.

On a face of the cube around the apex, a ray is a point (u, v), and q = 1 / depth its end. Planes stay planes there:
with n . x + m = depth (n_u u + n_v v + n_w + m q), a plane is tested against a box at the corner that is farthest along
its normal, with three products. The box in (u, v) is a pyramid with the apex, the paper's cone with a square section;
where the light is far away it is a box along the light's direction.
"""

from typing import NamedTuple

import numpy as np
from numba.extending import overload

from ..jit import inlined, kernel
from ..simd import as_i32, bits, broadcast16, fma, get, load16, ptr, put
from . import nodes as names
from .beams import AROUND, PERSPECTIVE
from .planes import nothing, sphere_of
from .view import projected, relative, turned

ROWS = 6  # of a node: u, v, q, each lowest and highest
OUTER, INNER, BOX, CORNERS, TRIANGLE, COVERS = 0, 16, 32, 38, 50, 51
"""Where a row has: four outer planes, four inner ones, the triangle's box, which rows of a node the farthest corners
of the outer planes are in, the triangle's number, and whether the inner planes hold."""

_F = np.float32
_E = np.float64(2.0**-20)  # above the rounding of a plane's numbers, a box's, and of their products, for sums up to 1
_INFINITE = np.float64(np.inf)
_HUGE = np.float64(1e30)
_TINY = np.float64(1e-30)  # above the rounding of numbers that float32 does not hold
_FAR = np.float64(2.0**-12)  # times _E: above the rounding of planes far from their corners, in units of these
_SLANT = np.float64(1e-6)  # more than a receiver on a face can be beyond its edges, in units of its distance


class Boxes(NamedTuple):
    """Nodes of a hierarchy; see `tree.Tree`."""

    numbers: np.ndarray

    ROWS = ROWS


@overload(names.pointed)
def _pointed(nodes):
    if nodes.instance_class is Boxes:
        return lambda nodes: Boxes(ptr(nodes.numbers))


@overload(names.rows_of)
def _rows_of(nodes):
    if nodes.instance_class is Boxes:
        return lambda nodes: ROWS


@inlined
def _put_box(group, ways, lane, low, high):
    for k in range(3):
        put(group, 2 * k * ways + lane, low[k])
        put(group, (2 * k + 1) * ways + lane, high[k])


@inlined
def _least(a, b):
    return a if a < b else b


@inlined
def _most(a, b):
    return a if a > b else b


@inlined
def _lower(a, b):
    return _least(a[0], b[0]), _least(a[1], b[1]), _least(a[2], b[2])


@inlined
def _upper(a, b):
    return _most(a[0], b[0]), _most(a[1], b[1]), _most(a[2], b[2])


@kernel
def _box_of_leaf(view, face, leaves, leaf, group, lane):
    """The box around the receivers of a leaf."""
    found = False
    low = _INFINITE, _INFINITE, _INFINITE
    high = -_INFINITE, -_INFINITE, -_INFINITE
    for i in range(leaves.ways):
        if get(leaves.ids, leaf * leaves.ways + i) >= 0:
            at = 3 * leaf * leaves.ways + i
            p = (
                get(leaves.origins, at),
                get(leaves.origins, at + leaves.ways),
                get(leaves.origins, at + 2 * leaves.ways),
            )
            d = relative(view, (np.float64(p[0]), np.float64(p[1]), np.float64(p[2])))
            u, v, q = projected(view, d, face)
            low, high, found = _lower(low, (u, v, q)), _upper(high, (u, v, q)), True
            if view.kind == PERSPECTIVE and not (0.0 < q < _HUGE):  # at the apex: nothing is known
                low, high = (-_INFINITE, -_INFINITE, -_INFINITE), (_INFINITE, _INFINITE, _INFINITE)
    if found:
        _put_box(group, leaves.ways, lane, low, high)
    return found


@kernel
def _box_of_nodes(children, alive, ways, group, lane):
    """The box around a group."""
    inf = _F(np.inf)
    low, high = (inf, inf, inf), (-inf, -inf, -inf)
    for i in range(ways):
        if alive >> i & 1:
            low = _lower(low, (get(children, i), get(children, 2 * ways + i), get(children, 4 * ways + i)))
            high = _upper(high, (get(children, ways + i), get(children, 3 * ways + i), get(children, 5 * ways + i)))
    _put_box(group, ways, lane, low, high)


@overload(names.bound_leaf)
def _bound_leaf(nodes, view, face, leaves, leaf, group, lane):
    if nodes.instance_class is Boxes:
        return lambda nodes, view, face, leaves, leaf, group, lane: _box_of_leaf(view, face, leaves, leaf, group, lane)


@overload(names.bound_node)
def _bound_node(nodes, children, alive, ways, group, lane):
    if nodes.instance_class is Boxes:
        return lambda nodes, children, alive, ways, group, lane: _box_of_nodes(children, alive, ways, group, lane)


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
    put(row, at, a)
    put(row, at + 1, b)
    put(row, at + 2, c)
    put(row, at + 3, d)


@inlined
def _corner(row, at, plane, ways):
    """Which rows of a node the corner is in that is farthest along a plane's normal."""
    whole = as_i32(row)
    put(whole, at, (1 if get(row, plane) > 0 else 0) * ways)
    put(whole, at + 1, (3 if get(row, plane + 1) > 0 else 2) * ways)
    put(whole, at + 2, (5 if get(row, plane + 3) > 0 else 4) * ways)


@inlined
def _shadow(x, z, r, low, high):
    """Lowest and highest place of what a corner's shadow can meet: of (x - k y) / (z - k w), |y|, |w| <= r, k <= 1."""
    near, far = 1.0 / (z - r), 1.0 / (z + r)
    low = _least(low, (x - r) * (near if x - r < 0.0 else far))
    return low, _most(high, (x + r) * (near if x + r > 0.0 else far))


@inlined
def _misses_face(corners, r):
    """Is a triangle, in a face's (u, v, depth), beyond one of the planes that bound the face, or behind the apex?"""
    a, b, c, d, behind = True, True, True, True, True
    for u, v, z in corners:
        far = -_SLANT * (abs(u) + abs(v) + abs(z)) - 2.001 * r
        a, b, c, d = a and z - u < far, b and z + u < far, c and z - v < far, d and z + v < far
        behind = behind and z < far
    return a or b or c or d or behind


@inlined
def _perspective_box(view, face, corners):
    """((u, v, q) lower, upper, is there anything?) of where the triangle's shadow is on a face."""
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
    """The same for a light that is far away, or all around, from the box of what blocks it."""
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
        put(row, BOX + 2 * k, low[k] - (_E * (abs(low[k]) + scale) + _TINY))
        put(row, BOX + 2 * k + 1, high[k] + (_E * (abs(high[k]) + scale) + _TINY))


@kernel
def _write_box_row(view, face, ways, shape, spheres, row):
    low, high = _lower(_lower(shape.a, shape.b), shape.c), _upper(_upper(shape.a, shape.b), shape.c)
    if spheres:  # the box of the sphere, and no planes
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
    put(as_i32(row), COVERS, 1 if shape.covers else 0)
    return True


@inlined
def _height(row, at, u, v, q):
    """f32x16: the plane at a place of a row, at the points (u, v, q)."""
    f = fma(u, broadcast16(row, at), broadcast16(row, at + 2))
    return fma(q, broadcast16(row, at + 3), fma(v, broadcast16(row, at + 1), f))


@inlined
def _not_outside(group, row, at, corner):
    """mask16 of the nodes whose farthest corner is not on the negative side of an outer plane."""
    u, v = load16(group, get(as_i32(row), corner)), load16(group, get(as_i32(row), corner + 1))
    q = load16(group, get(as_i32(row), corner + 2))
    f = fma(
        q,
        broadcast16(row, at + 3),
        fma(v, broadcast16(row, at + 1), fma(u, broadcast16(row, at), broadcast16(row, at + 2))),
    )
    return ~(f < _F(0.0))


@inlined
def _overlaps(group, row, ways):
    """mask16 of the nodes that overlap the box of the triangle's shadow."""
    u = (load16(group, 0) <= broadcast16(row, BOX + 1)) & (load16(group, ways) >= broadcast16(row, BOX))
    v = (load16(group, 2 * ways) <= broadcast16(row, BOX + 3)) & (load16(group, 3 * ways) >= broadcast16(row, BOX + 2))
    q = (load16(group, 4 * ways) <= broadcast16(row, BOX + 5)) & (load16(group, 5 * ways) >= broadcast16(row, BOX + 4))
    return u & v & q


@inlined
def _possible_boxes(group, row, ways):
    found = _overlaps(group, row, ways)
    for k in range(4):
        found = found & _not_outside(group, row, OUTER + 4 * k, CORNERS + 3 * k)
    return bits(found)


@inlined
def _inside(group, row, at, ways):
    """mask16 of the nodes whose nearest corner is on the positive side of an inner plane."""
    u = load16(group, (0 if get(row, at) > 0 else 1) * ways)
    v = load16(group, (2 if get(row, at + 1) > 0 else 3) * ways)
    q = load16(group, (4 if get(row, at + 3) > 0 else 5) * ways)
    f = fma(
        q,
        broadcast16(row, at + 3),
        fma(v, broadcast16(row, at + 1), fma(u, broadcast16(row, at), broadcast16(row, at + 2))),
    )
    return f > _F(0.0)


@inlined
def _covered_boxes(group, row, ways):
    if get(as_i32(row), COVERS) == 0:
        return np.int64(0)
    found = _inside(group, row, INNER, ways) & _inside(group, row, INNER + 4, ways)
    return bits(found & _inside(group, row, INNER + 8, ways) & _inside(group, row, INNER + 12, ways))


@overload(names.write_row)
def _write_row(nodes, view, face, ways, shape, spheres, row):
    if nodes.instance_class is Boxes:
        return lambda nodes, view, face, ways, shape, spheres, row: _write_box_row(
            view, face, ways, shape, spheres, row
        )


@overload(names.possible)
def _possible(nodes, group, row, ways, spheres):
    if nodes.instance_class is Boxes:
        return lambda nodes, group, row, ways, spheres: _possible_boxes(group, row, ways)


@overload(names.covered)
def _covered(nodes, group, row, ways):
    if nodes.instance_class is Boxes:
        return lambda nodes, group, row, ways: _covered_boxes(group, row, ways)
