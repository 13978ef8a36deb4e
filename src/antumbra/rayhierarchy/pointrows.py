"""Triangle rows for the tests of `boxes`, 16 triangles at once, for beams that end in one point.

The planes are those of `planes` in float32, with margins for the rounding error. Let u = 2^-24 and let the apex A be
exact. Each component of a = v0 - A, b, c and of the edges is one rounded difference. A normal n = a x e has errors of
at most 8 u |a| |e| (largest components) in each component. Evaluate n_u u + n_v v + n_w with |u|, |v| up to 1, each off
by at most 3 u. The sum is off by at most 54 u |a| |e|. The margin is 64 u, with the largest edge and corner.

The volume d = N . a is off by less than 100 u |e1| |e2| |a|. It decides the light's side only if it exceeds 128 u of
this product. If a product could overflow or may have underflowed, all planes are unknown.
"""

import numpy as np

from ..kernels.jit import inlined, kernel
from ..kernels.simd import (
    absolute,
    as_i32,
    bits,
    gather,
    get,
    load16,
    maximum,
    minimum,
    ptr_at,
    put,
    select,
    splat16,
    store,
)
from ..kernels.vec import Vec, cross, dot, largest, minus, times
from .boxrows import BOX, CORNERS
from .rows import COVERS, INNER, LANES, OUTER, TRIANGLE
from .view import relative16, turned

_F = np.float32
_MARGIN = _F(64 * 2.0**-24)
_SIDE = _F(128 * 2.0**-24)
_E = _F(2.0**-20)
_SLANT = _F(1e-6)
_INF = _F(np.inf)
_FLOOR = _F(1e-30)  # smaller volumes may have underflowed
_HUGE = _F(1e37)  # smaller numbers have not overflowed
_LARGE = _F(2.0**40)  # products of three smaller lengths cannot overflow


@inlined
def _corner(corners, at, k, view):
    """(corner k of 16 triangles, the same relative to the apex); at: i32x16, positions of their first numbers."""
    at = at + np.int32(3 * k)
    v = Vec(gather(corners, at), gather(corners, at + 1), gather(corners, at + 2))
    return v, relative16(view, v)


@inlined
def _put(rows, k, v):
    store(rows, LANES * k, v)


@inlined
def _put_plane(rows, k, n, c, d):
    """Write plane k of 16 triangles."""
    _put(rows, k, n[0])
    _put(rows, k + 1, n[1])
    _put(rows, k + 2, c)
    _put(rows, k + 3, d)


@inlined
def _put_planes(rows, k, normal, face, margin, d, more, ways):
    """Write outer plane k with d, inner plane k with d + more, and the positions of the farthest corners."""
    n = turned((normal.x, normal.y, normal.z), face)
    _put_plane(rows, OUTER + 4 * k, n, n[2] + margin, d)
    _put_plane(rows, INNER + 4 * k, n, n[2] - margin, d + more)
    zero, whole, none, step = _F(0.0), as_i32(rows), splat16(np.int32(0)), np.int32(ways)
    _put(whole, CORNERS + 3 * k, select(n[0] > zero, none + step, none))
    _put(whole, CORNERS + 3 * k + 1, select(n[1] > zero, none + 3 * step, none + 2 * step))
    _put(whole, CORNERS + 3 * k + 2, select(d > zero, none + 5 * step, none + 4 * step))


@inlined
def _beyond(z, x, far):
    """mask16: are all three corners beyond the plane depth = x? z, x, far: one per corner; far: the error margin."""
    return (z[0] - x[0] < far[0]) & (z[1] - x[1] < far[1]) & (z[2] - x[2] < far[2])


@inlined
def _minus(x):
    return -x[0], -x[1], -x[2]


@inlined
def _far(v):
    """f32x16: the error margin by which a corner must lie beyond a plane through the apex."""
    return (absolute(v.x) + absolute(v.y) + absolute(v.z)) * -_SLANT


@inlined
def _range(x, s, near):
    """(lowest, highest) of the corners' coordinates times s, their inverse depths; unbounded where not `near`."""
    a, b, c = x[0] * s[0], x[1] * s[1], x[2] * s[2]
    low, high = minimum(minimum(a, b), c), maximum(maximum(a, b), c)
    low, high = low - (absolute(low) + _F(1.0)) * _E, high + (absolute(high) + _F(1.0)) * _E
    return select(near, low, -_INF), select(near, high, _INF)


@inlined
def _put_box(rows, u, v, z, reach):
    """Write the boxes of the shadows of 16 triangles from their corners' coordinates, none larger than `reach`."""
    near, one = (minimum(minimum(z[0], z[1]), z[2]) > _FLOOR) & (reach < _HUGE), _F(1.0)
    s = one / select(near, z[0], one), one / select(near, z[1], one), one / select(near, z[2], one)
    u, v, q = _range(u, s, near), _range(v, s, near), maximum(maximum(s[0], s[1]), s[2])
    _put(rows, BOX, u[0])
    _put(rows, BOX + 1, u[1])
    _put(rows, BOX + 2, v[0])
    _put(rows, BOX + 3, v[1])
    _put(rows, BOX + 4, splat16(-_INF))
    _put(rows, BOX + 5, select(near, q + q * _E, _INF))


@inlined
def _turned(a, face):
    return turned((a.x, a.y, a.z), face)


@kernel
def write_point_rows(view, faces, parts, ways, slots, corners, lanes, how, rows, step, found):
    """Write the rows of 16 triangles for each face; write bits of the triangles whose shadow may meet it to `found`.

    faces : pointer to int64, the faces
    rows : pointer to the rows of the first face; the rows of the next face follow `step` numbers later
    slots : pointer to int32, indices of the triangles in `corners`, a pointer to float32
    lanes : bits of the lanes that have a triangle
    """
    at, one = load16(slots, 0), _F(1.0)
    (v0, a), (v1, b) = _corner(corners, at * 9, 0, view), _corner(corners, at * 9, 1, view)
    v2, c = _corner(corners, at * 9, 2, view)
    unit = _F(view.unit)
    e, f, g = times(minus(v1, v0), unit), times(minus(v2, v1), unit), times(minus(v0, v2), unit)
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
    n, ab, bc, ca = times(n, sign), times(cross(a, e), sign), times(cross(b, f), sign), times(cross(c, g), sign)
    near, far = (absolute(volume) * (one - _E) - slack) * -absolute(sign), (absolute(volume) * _E + slack) * _F(-2.0)
    none, wide = splat16(_F(0.0)), reach * _MARGIN
    slants = _far(a), _far(b), _far(c)
    for part in range(parts):
        face = get(faces, part)
        p, q, r = _turned(a, face), _turned(b, face), _turned(c, face)
        u, v, z = (p[0], q[0], r[0]), (p[1], q[1], r[1]), (p[2], q[2], r[2])
        gone = _beyond(z, u, slants) | _beyond(z, _minus(u), slants) | _beyond(z, v, slants)
        gone = gone | _beyond(z, _minus(v), slants) | _beyond(z, (none, none, none), slants)
        there = lanes & ~bits(gone)
        put(found, part, there)
        if there == 0:
            continue
        block = ptr_at(rows, part * step)
        _put_planes(block, 0, ab, face, wide * le, none, none, ways)
        _put_planes(block, 1, bc, face, wide * lf, none, none, ways)
        _put_planes(block, 2, ca, face, wide * lg, none, none, ways)
        _put_planes(block, 3, n, face, square * _MARGIN, near, far, ways)
        _put_box(block, u, v, z, reach)
        _put(as_i32(block), TRIANGLE, at)
        _put(as_i32(block), COVERS, select(covers, splat16(np.int32(1)), splat16(np.int32(0))))
