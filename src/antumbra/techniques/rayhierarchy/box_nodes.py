"""Box nodes: boxes in the beam's projection, tighter and cheaper than the paper's cones.

Boxes. On a face of the cube around the apex, a ray is a point (u, v), and q = 1 / depth gives its end. Planes stay
planes: n . x + m = depth (n_u u + n_v v + n_w + m q). A plane is tested at the box corner farthest along its normal,
with three products. The box in (u, v) is a pyramid from the apex: the paper's cone with a square cross section. For a
distant light, it is a box along the light's direction.

Rows in float32 have the planes of `shadow_planes` with margins for the rounding error. Let u = 2^-24, and let the apex
A be exact. Each component of a = v0 - A, b, c and of the edges is one rounded difference. Each component of a normal
n = a x e has an error of at most 8 u |a| |e| (largest components). With |u|, |v| up to 1 and errors of at most 3 u
each, the error of n_u u + n_v v + n_w is at most 54 u |a| |e|. The margin is 64 u times the largest edge and corner.

The error of the volume d = N . a is less than 100 u |e1| |e2| |a|; the light's side is known only if d exceeds 128 u
times this product. If a product could overflow or may have underflowed, all planes are unknown.
"""

from typing import NamedTuple

import numpy as np

from ...kernels.exact.filters import larger, smaller
from ...kernels.jit import inlined, kernel, overload
from ...kernels.simd import (
    absolute,
    as_i32,
    bits,
    broadcast16,
    fma,
    gather,
    get,
    load16,
    mask_from_bits16,
    maximum,
    minimum,
    ptr_at,
    put,
    reduce_max,
    reduce_min,
    select,
    splat16,
    store,
)
from ...kernels.vec3 import Vec3, cross, dot, largest, rows, scale3, subtract3
from . import ray_tree
from .light_beams import AROUND, PERSPECTIVE, projected16, relative16, turned
from .ray_leaves import BLOCK_BOX, HUGE, block_of, origins_in
from .shadow_planes import (
    COVERS,
    INNER,
    LANES,
    OUTER,
    TRIANGLE,
    integer,
    number,
    number16,
    put_integer,
    put_number,
    sphere_of,
    unknown_plane,
)

# --- Triangle rows in float64 for all kinds of beams, one triangle at a time ------------------------------------------

BOX, CORNERS = 32, 38
"""Positions in a row: the box of the triangle's shadow, and the box corners farthest along its outer planes."""

_E = np.float64(2.0**-19)  # exceeds the rounding error of planes, boxes and their products, for sums up to 1
_FAR = np.float64(2.0**-12)  # _FAR _E exceeds the relative rounding error of planes far from their corners
_TINY = np.float64(1e-30)  # exceeds the rounding error near the smallest float32 numbers
_INFINITE = np.float64(np.inf)
_SLANT = np.float64(1e-6)  # exceeds how far a receiver can lie beyond its face's edges, relative to its distance


@inlined
def lower(a, b):
    """The componentwise minimum of two points."""
    return smaller(a[0], b[0]), smaller(a[1], b[1]), smaller(a[2], b[2])


@inlined
def upper(a, b):
    """The componentwise maximum of two points."""
    return larger(a[0], b[0]), larger(a[1], b[1]), larger(a[2], b[2])


@inlined
def _put_plane(row, at, plane, view, face, scale, sign):
    """Write a plane as (a, b, c, d), for f = a u + b v + c + d q, slightly enlarged (sign 1) or shrunk (-1)."""
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
    put_integer(row, at, (1 if number(row, plane) > 0 else 0) * ways)
    put_integer(row, at + 1, (3 if number(row, plane + 1) > 0 else 2) * ways)
    put_integer(row, at + 2, (5 if number(row, plane + 3) > 0 else 4) * ways)


@inlined
def _shadow(x, z, r, low, high):
    """Extend (low, high) by a corner's shadow: by all (x - k y) / (z - k w) with |y|, |w| <= r and k <= 1."""
    inverse_near, inverse_far = 1.0 / (z - r), 1.0 / (z + r)
    low = smaller(low, (x - r) * (inverse_near if x - r < 0.0 else inverse_far))
    return low, larger(high, (x + r) * (inverse_near if x + r > 0.0 else inverse_far))


@inlined
def _misses_face(corners, r):
    """Whether a triangle is beyond a plane that bounds a face, or behind the apex. Corners are (u, v, depth)."""
    a, b, c, d, behind = True, True, True, True, True
    for u, v, z in corners:
        margin = -_SLANT * (abs(u) + abs(v) + abs(z)) - 2.001 * r
        a, b, c, d = a and z - u < margin, b and z + u < margin, c and z - v < margin, d and z + v < margin
        behind = behind and z < margin
    return a or b or c or d or behind


@inlined
def _perspective_box(view, face, corners):
    """(lower, upper, exists): the box in (u, v, q) of the triangle's shadow on a face, if there is one."""
    inf, r = _INFINITE, view.radius
    corners = turned(corners[0], face), turned(corners[1], face), turned(corners[2], face)
    if _misses_face(corners, r):
        return (inf, inf, inf), (-inf, -inf, -inf), False
    nearest = smaller(smaller(corners[0][2], corners[1][2]), corners[2][2])
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
    r = view.radius / np.sqrt(1.0 - view.radius * view.radius) * larger(high[2] - view.lowest, 0.0) * 1.000001
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
        scale = view.scale + _FAR * larger(_size(low), _size(high))
        low, high = _parallel_box(view, low, high)
    for k in range(4):
        outer = unknown_plane() if spheres else shape.outer[k]
        _put_plane(row, OUTER + 4 * k, outer, view, face, scale, np.float64(1.0))
        _put_plane(row, INNER + 4 * k, shape.inner[k], view, face, scale, np.float64(-1.0))
        _corner(row, CORNERS + 3 * k, OUTER + 4 * k, ways)
    _put_bounds(row, low, high, scale)
    put_integer(row, COVERS, 1 if shape.covers else 0)
    return True


# --- Triangle rows in float32 for beams that end in one point, 16 triangles at once -----------------------------------

_F = np.float32
_MARGIN = _F(64 * 2.0**-24)
_SIDE = _F(128 * 2.0**-24)
_POINT_ERROR = _F(2.0**-20)
_POINT_SLANT = _F(1e-6)
_INF = _F(np.inf)
_FLOOR = _F(1e-30)  # smaller volumes may have underflowed
_POINT_HUGE = _F(1e37)  # smaller numbers have not overflowed
_LARGE = _F(2.0**40)  # products of three smaller lengths cannot overflow


@inlined
def _point_corner(corners, at, k, view):
    """(corner k of 16 triangles, the same relative to the apex); at: i32x16, positions of their first numbers."""
    at = at + np.int32(3 * k)
    v = Vec3(gather(corners, at), gather(corners, at + 1), gather(corners, at + 2))
    return v, relative16(view, v)


@inlined
def _put(rows, k, v):
    store(rows, LANES * k, v)


@inlined
def _put_point_plane(rows, k, n, c, d):
    """Write plane k of 16 triangles."""
    _put(rows, k, n[0])
    _put(rows, k + 1, n[1])
    _put(rows, k + 2, c)
    _put(rows, k + 3, d)


@inlined
def _put_planes(rows, k, normal, face, margin, d, more, ways):
    """Write outer plane k with d, inner plane k with d + more, and the positions of the farthest corners."""
    n = turned((normal.x, normal.y, normal.z), face)
    _put_point_plane(rows, OUTER + 4 * k, n, n[2] + margin, d)
    _put_point_plane(rows, INNER + 4 * k, n, n[2] - margin, d + more)
    zero, integers, none, step = _F(0.0), as_i32(rows), splat16(np.int32(0)), np.int32(ways)
    _put(integers, CORNERS + 3 * k, select(n[0] > zero, none + step, none))
    _put(integers, CORNERS + 3 * k + 1, select(n[1] > zero, none + 3 * step, none + 2 * step))
    _put(integers, CORNERS + 3 * k + 2, select(d > zero, none + 5 * step, none + 4 * step))


@inlined
def _beyond(z, x, margins):
    """mask16: whether all three corners are beyond the plane depth = x. z, x, margins: one value per corner."""
    return (z[0] - x[0] < margins[0]) & (z[1] - x[1] < margins[1]) & (z[2] - x[2] < margins[2])


@inlined
def _minus(x):
    return -x[0], -x[1], -x[2]


@inlined
def _far(v):
    """f32x16: the error margin by which a corner must lie beyond a plane through the apex."""
    return (absolute(v.x) + absolute(v.y) + absolute(v.z)) * -_POINT_SLANT


@inlined
def _range(x, s, in_front):
    """(lowest, highest) product of the corners' coordinates and inverse depths s; unbounded where not `in_front`."""
    a, b, c = x[0] * s[0], x[1] * s[1], x[2] * s[2]
    low, high = minimum(minimum(a, b), c), maximum(maximum(a, b), c)
    low, high = low - (absolute(low) + _F(1.0)) * _POINT_ERROR, high + (absolute(high) + _F(1.0)) * _POINT_ERROR
    return select(in_front, low, -_INF), select(in_front, high, _INF)


@inlined
def _put_point_box(rows, u, v, z, reach):
    """Write the boxes of the shadows of 16 triangles. No coordinate of their corners is larger than `reach`."""
    in_front, one = (minimum(minimum(z[0], z[1]), z[2]) > _FLOOR) & (reach < _POINT_HUGE), _F(1.0)
    s = one / select(in_front, z[0], one), one / select(in_front, z[1], one), one / select(in_front, z[2], one)
    u, v, q = _range(u, s, in_front), _range(v, s, in_front), maximum(maximum(s[0], s[1]), s[2])
    _put(rows, BOX, u[0])
    _put(rows, BOX + 1, u[1])
    _put(rows, BOX + 2, v[0])
    _put(rows, BOX + 3, v[1])
    _put(rows, BOX + 4, splat16(-_INF))
    _put(rows, BOX + 5, select(in_front, q + q * _POINT_ERROR, _INF))


@inlined
def _turned(a, face):
    return turned((a.x, a.y, a.z), face)


@kernel
def write_point_rows(view, faces, parts, ways, slots, corners, lanes, how, rows, step, face_lanes):
    """Write the rows of 16 triangles for each face, and to `face_lanes` the bits of those whose shadow may meet it.

    faces : pointer to int64, the faces
    rows : pointer to the rows of the first face; the rows of the next face follow `step` numbers later
    slots : pointer to int32, indices of the triangles in `corners`, a pointer to float32
    lanes : bits of the lanes that have a triangle
    """
    at, one = load16(slots, 0), _F(1.0)
    (v0, a), (v1, b) = _point_corner(corners, at * 9, 0, view), _point_corner(corners, at * 9, 1, view)
    v2, c = _point_corner(corners, at * 9, 2, view)
    unit = _F(view.unit)
    e, f, g = scale3(subtract3(v1, v0), unit), scale3(subtract3(v2, v1), unit), scale3(subtract3(v0, v2), unit)
    n, le, lf, lg = cross(e, f), largest(e), largest(f), largest(g)
    size, reach = maximum(maximum(le, lf), lg), maximum(maximum(largest(a), largest(b)), largest(c))
    volume, square = dot(n, a), size * size
    slack = square * reach * _SIDE + _FLOOR
    known = (absolute(volume) > slack) & (size < _LARGE) & (reach < _LARGE)
    sign = select(known, select(volume > _F(0.0), splat16(one), splat16(-one)), _F(0.0))
    facing = -sign  # the sign of d . n
    covers = known
    if how.facing != 0:
        covers = known & (facing == _F(-how.facing))
        if how.backface:
            lanes &= ~bits(known & (facing == _F(how.facing)))
    n, ab, bc, ca = scale3(n, sign), scale3(cross(a, e), sign), scale3(cross(b, f), sign), scale3(cross(c, g), sign)
    outer_offset = (absolute(volume) * (one - _POINT_ERROR) - slack) * -absolute(sign)
    inner_offset = (absolute(volume) * _POINT_ERROR + slack) * _F(-2.0)
    none, wide = splat16(_F(0.0)), reach * _MARGIN
    slants = _far(a), _far(b), _far(c)
    for part in range(parts):
        face = get(faces, part)
        p, q, r = _turned(a, face), _turned(b, face), _turned(c, face)
        u, v, z = (p[0], q[0], r[0]), (p[1], q[1], r[1]), (p[2], q[2], r[2])
        gone = _beyond(z, u, slants) | _beyond(z, _minus(u), slants) | _beyond(z, v, slants)
        gone = gone | _beyond(z, _minus(v), slants) | _beyond(z, (none, none, none), slants)
        on_face = lanes & ~bits(gone)
        put(face_lanes, part, on_face)
        if on_face == 0:
            continue
        block = ptr_at(rows, part * step)
        _put_planes(block, 0, ab, face, wide * le, none, none, ways)
        _put_planes(block, 1, bc, face, wide * lf, none, none, ways)
        _put_planes(block, 2, ca, face, wide * lg, none, none, ways)
        _put_planes(block, 3, n, face, square * _MARGIN, outer_offset, inner_offset, ways)
        _put_point_box(block, u, v, z, reach)
        _put(as_i32(block), TRIANGLE, at)
        _put(as_i32(block), COVERS, select(covers, splat16(np.int32(1)), splat16(np.int32(0))))


# --- Nodes ------------------------------------------------------------------------------------------------------------

ROWS = 6  # numbers per node: the lowest and highest u, v and q


class Boxes(NamedTuple):
    """The node class of boxes; see `ray_tree`."""

    rows: int = ROWS  # float32 per node


@kernel
def _union_of_boxes(block, lanes, union):
    """Write the box around the shadow boxes of some of 16 triangles."""
    mask, inf = mask_from_bits16(lanes), _F(np.inf)
    for k in range(0, 6, 2):
        put(union, k, reduce_min(select(mask, load16(block, LANES * (BOX + k)), inf)))
        put(union, k + 1, reduce_max(select(mask, load16(block, LANES * (BOX + k + 1)), -inf)))
    return True


@inlined
def _meet_box(group, union, ways):
    """Bits of the nodes that a box meets."""
    overlaps = mask_from_bits16(0xFFFF)
    for k in range(0, 6, 2):
        overlaps = overlaps & (load16(group, k * ways) <= get(union, k + 1))
        overlaps = overlaps & (load16(group, (k + 1) * ways) >= get(union, k))
    return bits(overlaps)


@overload(ray_tree.union_of)
def _union_of(nodes, block, lanes, union):
    if nodes.instance_class is Boxes:
        return lambda nodes, block, lanes, union: _union_of_boxes(block, lanes, union)


@overload(ray_tree.meet_union)
def _meet_union(nodes, group, union, ways):
    if nodes.instance_class is Boxes:
        return lambda nodes, group, union, ways: _meet_box(group, union, ways)


@inlined
def _put_box(group, ways, lane, low, high):
    for k in range(3):
        put(group, 2 * k * ways + lane, low[k])
        put(group, (2 * k + 1) * ways + lane, high[k])


@kernel
def _box_of_leaf(view, face, leaves, leaf, group, lane):
    """Write the box around the receivers of a leaf; empty lanes are ignored."""
    ways, lanes = leaves.ways, get(leaves.lanes, leaf)
    if lanes == 0:
        return False
    there, block, inf = mask_from_bits16(lanes), block_of(leaves, leaf), _F(np.inf)
    if leaves.width > 0 and get(leaves.boxes, BLOCK_BOX * block) < inf:
        for k in range(ROWS):
            put(group, k * ways + lane, get(leaves.boxes, BLOCK_BOX * block + k))
        return True
    if leaves.width > 0:
        u, v, q = rows(leaves.points, 48 * block, 16)
    else:
        u, v, q = projected16(view, origins_in(leaves, block), face)
    if view.kind == PERSPECTIVE and bits(there & ~((q > _F(0.0)) & (q < HUGE))) != 0:  # a receiver at the apex
        _put_box(group, ways, lane, (-inf, -inf, -inf), (inf, inf, inf))
        return True
    _put_range(group, 0, ways, lane, there, u, u)
    _put_range(group, 2, ways, lane, there, v, v)
    _put_range(group, 4, ways, lane, there, q, q)
    return True


@inlined
def _put_range(group, k, ways, lane, there, low, high):
    """Write the lowest and highest numbers of the lanes that are `there` as numbers k and k + 1 of a node."""
    put(group, k * ways + lane, reduce_min(select(there, low, _F(np.inf))))
    put(group, (k + 1) * ways + lane, reduce_max(select(there, high, _F(-np.inf))))


@kernel
def _box_of_nodes(children, alive, ways, group, lane):
    """Write the box around a group."""
    there = mask_from_bits16(alive)
    for k in range(0, ROWS, 2):
        _put_range(group, k, ways, lane, there, load16(children, k * ways), load16(children, (k + 1) * ways))


@overload(ray_tree.bound_leaf)
def _bound_leaf(nodes, view, face, leaves, leaf, group, lane):
    if nodes.instance_class is Boxes:
        return lambda nodes, view, face, leaves, leaf, group, lane: _box_of_leaf(view, face, leaves, leaf, group, lane)


@overload(ray_tree.bound_node)
def _bound_node(nodes, children, alive, ways, group, lane):
    if nodes.instance_class is Boxes:
        return lambda nodes, children, alive, ways, group, lane: _box_of_nodes(children, alive, ways, group, lane)


@inlined
def height(row, at, u, v, q):
    """f32x16: the value of the plane at position `at` of a row for the points (u, v, q)."""
    f = fma(u, number16(row, at), number16(row, at + 2))
    return fma(q, number16(row, at + 3), fma(v, number16(row, at + 1), f))


@inlined
def _not_outside(group, row, at, corner):
    """mask16 of the nodes whose farthest corner is not on the negative side of an outer plane."""
    u, v = load16(group, integer(row, corner)), load16(group, integer(row, corner + 1))
    q = load16(group, integer(row, corner + 2))
    return ~(height(row, at, u, v, q) < _F(0.0))


@inlined
def _overlaps(group, row, ways):
    """mask16 of the nodes that overlap the box of the triangle's shadow."""
    u = (load16(group, 0) <= number16(row, BOX + 1)) & (load16(group, ways) >= number16(row, BOX))
    v = (load16(group, 2 * ways) <= number16(row, BOX + 3)) & (load16(group, 3 * ways) >= number16(row, BOX + 2))
    q = (load16(group, 4 * ways) <= number16(row, BOX + 5)) & (load16(group, 5 * ways) >= number16(row, BOX + 4))
    return u & v & q


@inlined
def _possible_boxes(group, row, ways, alive):
    candidates = bits(_overlaps(group, row, ways)) & alive
    if candidates == 0:
        return candidates
    own_plane = _not_outside(group, row, OUTER + 12, CORNERS + 9)
    ab, bc = _not_outside(group, row, OUTER, CORNERS), _not_outside(group, row, OUTER + 4, CORNERS + 3)
    return candidates & bits(own_plane & ab & bc & _not_outside(group, row, OUTER + 8, CORNERS + 6))


@inlined
def _farthest_outside(block, k, low, high):
    """mask16 of the triangles for which the farthest corner of a box is on the negative side of outer plane k."""
    at, zero = LANES * (OUTER + 4 * k), _F(0.0)
    a, b, d = load16(block, at), load16(block, at + LANES), load16(block, at + 3 * LANES)
    f = fma(select(a > zero, high.x, low.x), a, load16(block, at + 2 * LANES))
    f = fma(select(b > zero, high.y, low.y), b, f)
    return fma(select(d > zero, high.z, low.z), d, f) < zero


@kernel
def _possible_triangles_of_box(group, node, block, ways):
    """Bits of the triangles among 16 that may block rays of one box: `_possible_boxes` with the roles exchanged."""
    # In: group, the boxes of a group of nodes; node, its number in the group; block, 16 triangles; ways, of a group
    low = Vec3(broadcast16(group, node), broadcast16(group, 2 * ways + node), broadcast16(group, 4 * ways + node))
    node += ways
    high = Vec3(broadcast16(group, node), broadcast16(group, 2 * ways + node), broadcast16(group, 4 * ways + node))
    box, n = ptr_at(block, LANES * BOX), LANES
    overlaps = (low.x <= load16(box, n)) & (high.x >= load16(box, 0)) & (low.y <= load16(box, 3 * n))
    overlaps = overlaps & (high.y >= load16(box, 2 * n)) & (low.z <= load16(box, 5 * n))
    candidates = bits(overlaps & (high.z >= load16(box, 4 * n)))
    if candidates == 0:
        return candidates
    outside = _farthest_outside(block, 3, low, high) | _farthest_outside(block, 0, low, high)
    outside = outside | _farthest_outside(block, 1, low, high) | _farthest_outside(block, 2, low, high)
    return candidates & ~bits(outside)


@inlined
def _inside(group, row, at, ways):
    """mask16 of the nodes whose nearest corner is on the positive side of an inner plane."""
    u = load16(group, (0 if number(row, at) > 0 else 1) * ways)
    v = load16(group, (2 if number(row, at + 1) > 0 else 3) * ways)
    q = load16(group, (4 if number(row, at + 3) > 0 else 5) * ways)
    return height(row, at, u, v, q) > _F(0.0)


@inlined
def _covered_boxes(group, row, ways, among):
    u = (load16(group, 0) >= number16(row, BOX)) & (load16(group, ways) <= number16(row, BOX + 1))
    v = (load16(group, 2 * ways) >= number16(row, BOX + 2)) & (load16(group, 3 * ways) <= number16(row, BOX + 3))
    if bits(u & v) & among == 0 or integer(row, COVERS) == 0:  # early exit: few nodes lie in a triangle's box
        return 0
    inside = _inside(group, row, INNER, ways) & _inside(group, row, INNER + 4, ways)
    return bits(inside & _inside(group, row, INNER + 8, ways) & _inside(group, row, INNER + 12, ways)) & among


@overload(ray_tree.write_row)
def _write_row(nodes, view, face, ways, shape, spheres, row):
    if nodes.instance_class is Boxes:
        return lambda nodes, view, face, ways, shape, spheres, row: write_box_row(view, face, ways, shape, spheres, row)


@overload(ray_tree.writes_sixteen)
def _writes_sixteen(nodes):
    if nodes.instance_class is Boxes:
        return lambda nodes: True


@overload(ray_tree.possible)
def _possible(nodes, group, row, ways, alive, spheres):
    if nodes.instance_class is Boxes:
        return lambda nodes, group, row, ways, alive, spheres: _possible_boxes(group, row, ways, alive)


@overload(ray_tree.possible_triangles)
def _possible_triangles(nodes, group, node, block, ways):
    if nodes.instance_class is Boxes:
        return lambda nodes, group, node, block, ways: _possible_triangles_of_box(group, node, block, ways)


@overload(ray_tree.covered)
def _covered(nodes, group, row, ways, among):
    if nodes.instance_class is Boxes:
        return lambda nodes, group, row, ways, among: _covered_boxes(group, row, ways, among)
