"""The point of a scene's faces that is closest to each of many points.

A point walks the wide BVH depth first, and enters the nearest of the eight boxes first. In a leaf, a filter rules out
those of eight triangles that are surely farther than the closest one so far. The others are measured in float64.

Filter. For any vector g, a triangle is at least min g . (corner - point) / |g| away. With g from the point to a place
of the triangle that float32 finds the closest, this is nearly its distance, and true whichever place was found.

Distances. Corners and points are float32, so their differences are float64, and the normal of a face has a relative
error of a few units in the last place even if the face is a sliver (`_difference_of_products`). Above a face, its plane
gives the distance; elsewhere, an edge does. Both faces of an edge measure it from the same end, so that they agree on
its distance. Errors are below `ERROR` of the distance plus the longest edge of the face. Boxes and triangles are
ruled out only if they are farther by more than that: the result is the least of all measured distances, of equal ones
that of the lowest face, whatever the tree.
"""

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..bvh.nodes import GROUP_WORDS, LINKS, NODE_WORDS, WIDTH, wide_leaf, wide_tree_of
from ..kernels.jit import F32x8, I32Ptr, inlined, kernel
from ..kernels.marshalling import Packed
from ..kernels.parallel import items, new_ticket, run
from ..kernels.simd import (
    absolute,
    as_f32,
    bits,
    fma,
    get,
    load8,
    lowest_bit,
    maximum,
    minimum,
    permute,
    popcount,
    product_error,
    select,
    splat8,
    stack_i32,
    store,
)
from ..scene.triangles import ClosestPoints
from .rays.wide_traversal import LANE, STACK, group_of, largest_of, sorted_keys

ERROR = 2.0**-48
"""Bound on the error of a distance, relative to the distance plus the longest edge of its face."""

_POINTS = 64  # points that a thread takes together; each begins with the closest face of the one before
_ROOM = STACK + 2 * WIDTH
_MARGIN = 2.0**-44  # of the largest coordinate: more than the errors of two distances
_LEAST = 2.0**-120  # squared distances below it are the same to the walk
_EARLIER, _LATER = 1.0 - 2.0**-19, 1.0 + 2.0**-18  # more than the lane in a key, and the rounding of float32 squares
_ROUNDING = np.float32(2.0**-19)  # of a filter's sums, relative to the lengths in them
_MOST, _TINY = np.float32(3e38), np.float32(1e-37)
_SMALL, _LARGE = np.float32(2.0**-28), np.float32(2.0**28)  # coordinates between which the filter does not overflow
_ZERO, _ONE, _TWO, _THREE = (np.float32(x) for x in (0.0, 1.0, 2.0, 3.0))


# --- Boxes and triangles, eight at a time -----------------------------------------------------------------------------


class _Point8(NamedTuple):
    """A point in eight lanes."""

    x: F32x8
    y: F32x8
    z: F32x8


@inlined
def _outside(nodes, at, axis, p):
    """The distances along an axis of the eight boxes of the node at word `at` from a coordinate."""
    lower, upper = load8(nodes, at + 2 * WIDTH * axis), load8(nodes, at + 2 * WIDTH * axis + WIDTH)
    return maximum(maximum(lower - p, p - upper), splat8(_ZERO))


@inlined
def _box_squares(nodes, at, p):
    """(mask of the children of the node at word `at`, squared distances of their boxes)."""
    x, y, z = _outside(nodes, at, 0, p.x), _outside(nodes, at, 1, p.y), _outside(nodes, at, 2, p.z)
    present = load8(nodes, at) <= load8(nodes, at + WIDTH)
    return present, minimum(fma(x, x, fma(y, y, z * z)), splat8(_MOST))


@inlined
def _share(part, whole):
    """part / whole, limited to 0 .. 1."""
    return minimum(maximum(part / maximum(whole, splat8(_TINY)), splat8(_ZERO)), splat8(_ONE))


@inlined
def _dot8(ax, ay, az, bx, by, bz):
    return fma(ax, bx, fma(ay, by, az * bz))


@inlined
def _may_be_closer(p, t, limit):
    """Mask of the triangles of a group, `t`, that may be closer to a point than `limit`, a float32."""
    rx, ry, rz = p.x - t.x, p.y - t.y, p.z - t.z
    a, b = _dot8(t.px, t.py, t.pz, t.px, t.py, t.pz), _dot8(t.px, t.py, t.pz, t.qx, t.qy, t.qz)
    c, d = _dot8(t.qx, t.qy, t.qz, t.qx, t.qy, t.qz), _dot8(t.px, t.py, t.pz, rx, ry, rz)
    e = _dot8(t.qx, t.qy, t.qz, rx, ry, rz)
    along1, along2, along3 = _share(d, a), _share(e, c), _share((e - b) - (d - a), (a - b) - (b - c))
    # squared distances from the first corner's, of the places on the edges
    far1, far2 = along1 * (along1 * a - _TWO * d), along2 * (along2 * c - _TWO * e)
    v, w = select(far1 < far2, along1, splat8(_ZERO)), select(far1 < far2, splat8(_ZERO), along2)
    v3, w3 = splat8(_ONE) - along3, along3
    far3 = v3 * (v3 * a - _TWO * d + _TWO * w3 * b) + w3 * (w3 * c - _TWO * e)
    opposite = far3 < minimum(far1, far2)
    v, w = select(opposite, v3, v), select(opposite, w3, w)
    area, over1, over2 = maximum(a * c - b * b, splat8(_TINY)), c * d - b * e, a * e - b * d
    above = (over1 >= splat8(_ZERO)) & (over2 >= splat8(_ZERO)) & (over1 + over2 <= area)
    v, w = select(above, over1 / area, v), select(above, over2 / area, w)
    gx, gy, gz = fma(v, t.px, fma(w, t.qx, -rx)), fma(v, t.py, fma(w, t.qy, -ry)), fma(v, t.pz, fma(w, t.qz, -rz))
    first = -_dot8(gx, gy, gz, rx, ry, rz)
    second, third = first + _dot8(gx, gy, gz, t.px, t.py, t.pz), first + _dot8(gx, gy, gz, t.qx, t.qy, t.qz)
    least, lengths = minimum(first, minimum(second, third)), absolute(rx) + absolute(ry) + absolute(rz)
    reached = splat8(limit) + _ROUNDING * (lengths + _THREE * t.s)
    square = _dot8(gx, gy, gz, gx, gy, gz) * (reached * reached)
    return (least <= splat8(_ZERO)) | (least * least <= square * np.float32(_LATER))


# --- One triangle -----------------------------------------------------------------------------------------------------


class _Point(NamedTuple):
    """A point, in float64."""

    x: np.float64
    y: np.float64
    z: np.float64


class _Place(NamedTuple):
    """The place of a triangle that is closest to a point, from the triangle's first corner on."""

    square: np.float64  # squared distance
    x: np.float64
    y: np.float64
    z: np.float64
    u: np.float64  # weight of the second corner
    v: np.float64  # weight of the third corner


@inlined
def _difference_of_products(a, b, c, d):
    """a b - c d, with a relative error of a few units in the last place [Kahan]."""
    p, q = a * b, c * d
    return (p - q) + (product_error(a, b, p) - product_error(c, d, q))


@inlined
def _cross(ax, ay, az, bx, by, bz):
    return (
        _difference_of_products(ay, bz, az, by),
        _difference_of_products(az, bx, ax, bz),
        _difference_of_products(ax, by, ay, bx),
    )


@inlined
def _comes_first(corners, a, b):
    """Whether the corner at word a precedes that at word b, in the order of coordinates."""
    ax, ay, bx, by = get(corners, a), get(corners, a + 1), get(corners, b), get(corners, b + 1)
    if ax != bx:
        return ax < bx
    return ay < by if ay != by else get(corners, a + 2) < get(corners, b + 2)


@inlined
def _from_corner(corners, a, point):
    """From the corner at word a to a point, in float64."""
    f = np.float64
    return point.x - f(get(corners, a)), point.y - f(get(corners, a + 1)), point.z - f(get(corners, a + 2))


@inlined
def _difference(corners, a, b):
    """From the corner at word a to that at word b."""
    f = np.float64
    return _from_corner(corners, a, _Point(f(get(corners, b)), f(get(corners, b + 1)), f(get(corners, b + 2))))


@kernel
def _on_edge(point, corners, begin, end):
    """(squared distance of a point from an edge, share of the way from word `begin` to `end` of `corners`)."""
    f, swapped = np.float64, not _comes_first(corners, begin, end)
    a, b = (end, begin) if swapped else (begin, end)
    ex, ey, ez = _difference(corners, a, b)
    rx, ry, rz = _from_corner(corners, a, point)
    along, length = rx * ex + ry * ey + rz * ez, ex * ex + ey * ey + ez * ez
    share = along / length if along > 0.0 else f(0.0)
    if along >= length:
        share = f(1.0)
        rx, ry, rz = _from_corner(corners, b, point)
    else:
        rx, ry, rz = rx - share * ex, ry - share * ey, rz - share * ez
    return rx * rx + ry * ry + rz * rz, f(1.0) - share if swapped else share


@kernel
def _closest_on(point, corners, slot):
    """The `_Place` of the triangle in a slot of `corners` that is closest to a point."""
    f, a = np.float64, 9 * slot
    b, c = a + 3, a + 6
    (px, py, pz), (qx, qy, qz) = _difference(corners, a, b), _difference(corners, a, c)
    rx, ry, rz = _from_corner(corners, a, point)
    nx, ny, nz = _cross(px, py, pz, qx, qy, qz)
    (ex, ey, ez), (sx, sy, sz) = _difference(corners, b, c), _from_corner(corners, b, point)
    # the weight of each corner in the place below the point, times the square of the normal; each from its own edge
    of_a = (ny * ez - nz * ey) * sx + (nz * ex - nx * ez) * sy + (nx * ey - ny * ex) * sz
    of_b = (ny * qz - nz * qy) * -rx + (nz * qx - nx * qz) * -ry + (nx * qy - ny * qx) * -rz
    of_c = (ny * pz - nz * py) * rx + (nz * px - nx * pz) * ry + (nx * py - ny * px) * rz
    square = nx * nx + ny * ny + nz * nz
    best, u, v = f(np.inf), f(0.0), f(0.0)
    if square > 0.0 and of_a >= 0.0 and of_b >= 0.0 and of_c >= 0.0:
        height = nx * rx + ny * ry + nz * rz
        away = height / square
        return _Place(height * away, rx - away * nx, ry - away * ny, rz - away * nz, of_b / square, of_c / square)
    if of_c <= 0.0 or not square > 0.0:
        best, share = _on_edge(point, corners, a, b)
        u = share
    if of_b <= 0.0 or not square > 0.0:
        other, share = _on_edge(point, corners, a, c)
        if other < best:
            best, u, v = other, f(0.0), share
    if of_a <= 0.0 or not square > 0.0:
        other, share = _on_edge(point, corners, b, c)
        if other < best:
            best, u, v = other, f(1.0) - share, share
    return _Place(best, u * px + v * qx, u * py + v * qy, u * pz + v * qz, u, v)


# --- Traversal --------------------------------------------------------------------------------------------------------


class _Best(NamedTuple):
    """The closest triangle so far."""

    square: np.float64
    slot: int  # -1: none
    face: int


@inlined
def _measured(tree, point, slot, best):
    """The closer one of the triangle in a slot and the best one so far; of equally close ones, the lower face."""
    square, face = _closest_on(point, tree.corners, slot).square, np.int64(get(tree.prim_ids, slot))
    if square < best.square or (square == best.square and face < best.face):
        return _Best(square, slot, face)
    return best


class _Stack(NamedTuple):
    """Nodes and leaves to visit: pointers to scratch memory."""

    keys: I32Ptr  # int32 *: keys of `sorted_keys`
    links: I32Ptr  # int32 *


@inlined
def _push(tree, node, p, square, stack, top):
    """Push the children of a node whose boxes may be as close as `square`, the closest on top. Return the new top."""
    at = node * NODE_WORDS
    present, squares = _box_squares(tree.nodes, at, p)
    near = present & (squares <= splat8(np.float32(square)))
    keys = sorted_keys(near, squares)
    store(stack.keys, top, keys)
    store(stack.links, top, permute(load8(tree.links, at + LINKS), keys & LANE))
    return top + popcount(bits(near))


@inlined
def _measured_leaf(tree, point, p, link, limit, best):
    """The closest triangle so far, with those of a leaf; `limit`: a distance beyond which they do not matter."""
    group, n = wide_leaf(link)
    lanes = np.int64((1 << n) - 1)
    if limit < _LARGE:
        lanes &= bits(_may_be_closer(p, group_of(tree.groups, group * GROUP_WORDS), limit))
    while lanes:
        k = lowest_bit(lanes)
        lanes &= lanes - 1
        best = _measured(tree, point, np.int64(get(tree.slots, group * WIDTH + k)), best)
    return best


@inlined
def _limits(square, margin):
    """(distance, its square) that nothing to be found exceeds, if the best so far has this squared distance."""
    far = np.sqrt(square) + margin
    return far, far * far + _LEAST


@kernel
def _closest(tree, point, seed, stack):
    """The slot of the triangle of a tree that is closest to a point, -1 if there is none.

    seed : a slot to begin with, or -1
    stack : scratch memory
    """
    f, (x, y, z) = np.float32, point
    p, link, top = _Point8(splat8(f(x)), splat8(f(y)), splat8(f(z))), np.int64(0), np.int64(0)
    reach = max(max(abs(x), max(abs(y), abs(z))), np.float64(largest_of(tree.reach)))
    margin, tame = reach * _MARGIN, reach > _SMALL and reach < _LARGE
    best = _Best(np.float64(np.inf), np.int64(-1), np.int64(1 << 40))
    if seed >= 0:
        best = _measured(tree, point, seed, best)
    far, square = _limits(best.square, margin)
    while True:
        if link >= 0:
            top = _push(tree, link, p, square * _LATER, stack, top)
        else:
            best = _measured_leaf(tree, point, p, link, f(far * _LATER) if tame else _MOST, best)
            far, square = _limits(best.square, margin)
        while top > 0 and np.float64(get(as_f32(stack.keys), top - 1)) * _EARLIER > square:
            top -= 1
        if top == 0:
            return best.slot
        top -= 1
        link = np.int64(get(stack.links, top))


@kernel
def _find(ticket, wide, points, out):
    """Worker: write the closest point in a `wide` BVH of each of the points, (n, 3) float32, to `out`."""
    tree, stack = wide_tree_of(wide), _Stack(stack_i32(_ROOM), stack_i32(_ROOM))
    for batch in items(ticket):
        slot, f = np.int64(-1), np.float64
        for i in range(batch * _POINTS, min((batch + 1) * _POINTS, len(points))):
            point = _Point(f(points[i, 0]), f(points[i, 1]), f(points[i, 2]))
            slot = _closest(tree, point, slot, stack)
            if slot < 0:
                out.face[i], out.distance[i], out.u[i], out.v[i] = -1, np.inf, _ZERO, _ZERO
                out.position[i, 0] = out.position[i, 1] = out.position[i, 2] = np.nan
                continue
            place = _closest_on(point, tree.corners, slot)
            out.face[i], out.distance[i] = get(tree.prim_ids, slot), np.sqrt(place.square)
            out.u[i], out.v[i] = np.float32(place.u), np.float32(place.v)
            for axis, offset in enumerate((place.x, place.y, place.z)):
                out.position[i, axis] = f(get(tree.corners, 9 * slot + axis)) + offset


def closest_points(tree: Packed, points: NDArray[np.float32], threads: int) -> ClosestPoints:
    """The closest points of a tree to points, in its frame.

    tree : a `WideBvh`, packed
    points : (n, 3) float32, finite, in the frame of the tree
    """
    n, f = len(points), np.float32
    out = ClosestPoints(np.empty(n), np.empty(n, np.int32), np.empty(n, f), np.empty(n, f), np.empty((n, 3)))
    run(_find, threads, new_ticket(-(-n // _POINTS), 1), tree, points, out)
    return out


def closer_of(one: ClosestPoints, other: ClosestPoints) -> ClosestPoints:
    """The closer of two closest points of each point, of equally close ones that of the lower face; changes `one`."""
    nearer = (other.distance < one.distance) | ((other.distance == one.distance) & (other.face < one.face))
    pairs: Any = zip(one, other)
    for mine, others in pairs:
        mine[nearer] = others[nearer]
    return one
