"""Traversal of a binary BVH by one ray: one function for any-hit and closest-hit.

Orders. An any-hit ray ends at its first hit, so the child order determines how many nodes it visits. An order is a
number, which `walk` passes to `left_comes_first` at each node where the ray enters both boxes. An order that is the
same for all rays at a node costs nothing, since the builder stores the first child as the left one. `rtsah` does so,
and the builder `srdh` where it chooses a fixed order.

Tests. Boxes are tested conservatively in float32, both children of a node at once, with one 4-wide register per axis.
Triangles are tested by the filters of `antumbra.kernels.exact`, which fall back to the exact predicate. So the
answer is the contract's, and does not depend on the tree.
"""

from typing import NamedTuple

import numpy as np

from ...bvh.nodes import (
    BACK_TO_FRONT,
    EMPTY,
    FRONT_TO_BACK,
    LEFT_FIRST,
    MAX_DEPTH,
    UNORDERED,
    Bvh,
    bvh_leaf,
    line_at,
    link_at,
    order_at,
)
from ...kernels.exact.filters import (
    BEYOND,
    UNSURE,
    comes_first,
    float32_end,
    hit_t,
    max_magnitude,
    rounded_t,
    verdict,
    volumes32,
    volumes64,
)
from ...kernels.exact.predicate import exact_meets, misses_bounds
from ...kernels.jit import F32x4, I32Ptr, inlined, kernel, overload
from ...kernels.simd import (
    as_i32,
    bits,
    extract,
    get,
    load4,
    mask_from_bits4,
    maximum,
    minimum,
    put,
    select,
    splat4,
    stack_f32,
    stack_i32,
    swap_halves,
)
from ..counters import BOX_TESTS, EXACT, NODES, TRIANGLE_TESTS, UNCERTAIN, count

# --- Traversal orders [Feltman et al. 2012, Sec. 3.1] -----------------------------------------------------------------


CLOSEST = -1  # instead of an any-hit order: find the nearest hit
BUILT = UNORDERED  # the builder's choice at each node, or else the child whose box is entered first
RANDOM, SRDH, NEAREST = 4, 5, 6  # besides LEFT_FIRST, FRONT_TO_BACK and BACK_TO_FRONT, by the children's centres


@inlined
def _squared(nodes, at, o):
    """Squared distances of twice the boxes' centres from twice the coordinate o, along one axis, in lanes 0 and 1."""
    planes = load4(nodes, at)
    away = planes + swap_halves(planes) - np.float32(2.0) * o
    return away * away


@inlined
def _left_is_closer(nodes, node, o):
    """Whether the centre of the left child's box is closer to the ray's origin."""
    b = line_at(node)
    away = _squared(nodes, b, o[0]) + _squared(nodes, b + 4, o[1]) + _squared(nodes, b + 8, o[2])
    return extract(away, 0) <= extract(away, 1)


@kernel
def _toss(node, o, d):
    """A pseudorandom bool that depends only on the ray and the node."""
    words = stack_f32(6)
    for k in range(3):
        put(words, k, o[k])
        put(words, 3 + k, d[k])
    h = np.uint32(node) * np.uint32(0x9E3779B1)
    for k in range(6):
        h = np.uint32((h ^ np.uint32(get(as_i32(words), k))) * np.uint32(0x85EBCA6B))
        h ^= h >> np.uint32(15)
    h = np.uint32(h * np.uint32(0xC2B2AE35))
    return (h >> np.uint32(31)) == 0


@kernel
def _by_ray(order, nodes, node, a, b, o, d):
    """`left_comes_first` of an order that depends on the ray. Not inlined, because it is rarely needed."""
    if order == FRONT_TO_BACK:
        return _left_is_closer(nodes, node, o)
    if order == BACK_TO_FRONT:
        return not _left_is_closer(nodes, node, o)
    if order == RANDOM:
        return _toss(node, o, d)
    return a <= b


@inlined
def left_comes_first(order, nodes, links, node, a, b, o, d):
    """Whether a ray from o along d visits a node's left child first.

    a, b : entry t of the boxes of the left and the right child
    """
    if order == BUILT or order == SRDH:
        chosen = get(links, order_at(node))
        if chosen == LEFT_FIRST:
            return True
        if chosen == UNORDERED and order == BUILT:
            return a <= b
        order = chosen if chosen != UNORDERED else np.int64(RANDOM)
    if order == CLOSEST:
        return a <= b
    return order == LEFT_FIRST or _by_ray(order, nodes, node, a, b, o, d)


class Ordered(NamedTuple):
    """The input of the tracer `single`: a BVH and its child order."""

    bvh: Bvh
    order: int


# --- One ray through a binary BVH -------------------------------------------------------------------------------------


_STACK = 2 * MAX_DEPTH
_TINY = np.float32(1e-20)  # a direction's component below this fraction of the largest one counts as zero
_LEAST = np.float32(1e-35)  # so does a component below this, whose reciprocal could overflow
_SHORT = np.float32(1e-28)  # rays with shorter directions visit every node, because _LEAST would turn them
_GROW = np.float32(1.0 + 2.0**-20)  # more than the 8 roundings between the two ends of a slab interval
_PAD = np.float32(2.0**-21)  # fraction of the largest coordinate, see `_slab`


class BoxRay(NamedTuple):
    """A ray prepared for slab tests: (plane - from) * inverse, `from` per lane (L.lower R.lower L.upper R.upper)."""

    x: F32x4
    y: F32x4
    z: F32x4
    ix: F32x4
    iy: F32x4
    iz: F32x4
    tmin: F32x4


@inlined
def _slab(o, d, limit, pad):
    """(origin for lower planes, origin for upper planes, reciprocal) of one axis.

    A ray perpendicular to the axis must count as inside a slab whose boundary it touches. So its origin is moved
    inwards by the tiny `pad`, which makes the boundary's t huge, with the right sign. The reciprocal is always finite,
    so NaN cannot arise.
    """
    if abs(d) > limit:
        return o, o, np.float32(1.0) / d
    return o + pad, o - pad, np.float32(1.0) / limit


@kernel
def _reach(nodes, reach):
    """The largest of `reach` and the magnitudes of the root's bounds."""
    for k in range(12):
        bound = abs(get(nodes, k))
        if bound > reach and bound < np.float32(np.inf):
            reach = bound
    return reach


@inlined
def box_ray(nodes, ray):
    """The `BoxRay` of a `Ray`."""
    f = np.float32
    ox, oy, oz = f(ray.ox), f(ray.oy), f(ray.oz)
    dx, dy, dz = f(ray.dx), f(ray.dy), f(ray.dz)
    largest = max_magnitude((dx, dy, dz))
    limit = max(_TINY * largest, _LEAST)
    pad = f(0.0)
    if abs(dx) <= limit or abs(dy) <= limit or abs(dz) <= limit:
        pad = _PAD * _reach(nodes, max_magnitude((ox, oy, oz)))
    lx, ux, ix = _slab(ox, dx, limit, pad)
    ly, uy, iy = _slab(oy, dy, limit, pad)
    lz, uz, iz = _slab(oz, dz, limit, pad)
    tmin = f(ray.tmin)
    if largest < _SHORT:
        ix, iy, iz, tmin = f(0.0), f(0.0), f(0.0), f(0.0)
    low = mask_from_bits4(3)
    x, y, z = (
        select(low, splat4(lx), splat4(ux)),
        select(low, splat4(ly), splat4(uy)),
        select(low, splat4(lz), splat4(uz)),
    )
    return BoxRay(x, y, z, splat4(ix), splat4(iy), splat4(iz), splat4(tmin))


@kernel
def settle(ray, corners, slot, counters):
    """Decide a ray-triangle test that is undecided in float32: by the triangle's bounds, in float64, then exactly.

    The bounds come first, because rays far longer than a scene is wide pass the boxes of many small triangles in
    float32. Not inlined, to keep this code out of hot loops.
    """
    if misses_bounds(ray, corners, slot):
        return 0
    count(counters, UNCERTAIN, 1)
    side = verdict(volumes64(ray, corners, slot), ray.tmin, ray.tmax)
    if side == UNSURE:
        count(counters, EXACT, 1)
        side = exact_meets(ray, corners, slot)
    return side


@inlined
def triangle_hit(corners, slot, ray, o, d, cull_faces, counters):
    """True if the ray meets the triangle in `slot`; o, d: its origin and direction in float32."""
    count(counters, TRIANGLE_TESTS, 1)
    side = verdict(volumes32(o, d, corners, slot), float32_end(ray.tmin), float32_end(ray.tmax))
    if side == UNSURE:
        side = settle(ray, corners, slot, counters)
    return side != 0 and side != cull_faces


@inlined
def enter_boxes(nodes, node, box, limit):
    """Test both children of a node: (bits of the boxes that the ray enters before `limit`, vector of entry t)."""
    b = line_at(node)
    tx, ty, tz = (
        (load4(nodes, b) - box.x) * box.ix,
        (load4(nodes, b + 4) - box.y) * box.iy,
        (load4(nodes, b + 8) - box.z) * box.iz,
    )
    sx, sy, sz = swap_halves(tx), swap_halves(ty), swap_halves(tz)
    t_near = maximum(maximum(minimum(tx, sx), minimum(ty, sy)), maximum(minimum(tz, sz), box.tmin))
    t_far = minimum(minimum(maximum(tx, sx), maximum(ty, sy)), minimum(maximum(tz, sz), limit))
    return bits(t_near <= t_far * _GROW) & 3, t_near


class HitList(NamedTuple):
    """A hit filter that records all triangles that a ray meets."""

    prims: I32Ptr  # int32 *: triangle indices
    count: I32Ptr  # int32 *: the number of triangles
    room: int  # largest number of triangles; others are dropped


def ignores_hit(hit_filter, ray, corners, slot, prim):
    """In kernels: True if traversal continues as if the ray did not meet the triangle in `slot`.

    The type of the filter selects the implementation. None ignores no hit; a `HitList` records and ignores all.
    """


@kernel
def _record_hit(hits, prim):
    n = get(hits.count, 0)
    if n < hits.room:
        put(hits.prims, n, prim)
        put(hits.count, 0, n + 1)
    return True


@overload(ignores_hit)
def _ignores_hit(hit_filter, ray, corners, slot, prim):
    if str(hit_filter) == "none":
        return lambda hit_filter, ray, corners, slot, prim: False
    if getattr(hit_filter, "instance_class", None) is HitList:
        return lambda hit_filter, ray, corners, slot, prim: _record_hit(hit_filter, prim)
    return None


@kernel
def walk(tree, ray, skip, cull_faces, order, hit_filter, counters):
    """(slot, t) of a triangle that the ray meets: any one, or the nearest (ties: `filters.precedes`).

    slot is -1 on a miss. t is computed only for the nearest hit, by `rounded_t`.

    skip : index of a triangle to ignore, or -1
    order : CLOSEST for the nearest hit; otherwise any hit, with children visited in this order
    hit_filter : None, or a filter that may ignore hits, see `ignores_hit`

    Both boxes of a node are tested at once. For any-hit, box tests are counted one by one, when the traversal reaches a
    box. The second box counts only if the first one's subtree does not block the ray [Feltman et al. 2012, Sec. 3.1].
    """
    nodes, links = tree.nodes, tree.links
    stack, entry = stack_i32(_STACK), stack_f32(_STACK)
    box = box_ray(nodes, ray)
    o = (np.float32(ray.ox), np.float32(ray.oy), np.float32(ray.oz))
    d = (np.float32(ray.dx), np.float32(ray.dy), np.float32(ray.dz))
    best, best_id, best_t = -1, -1, ray.tmax
    limit = np.float32(best_t * BEYOND)
    one_by_one = order != CLOSEST and counters is not None
    height = 0
    link = 0
    while True:
        if link >= 0:
            count(counters, NODES, 1)
            count(counters, BOX_TESTS, 1 if one_by_one else 2)
            mask, t_near = enter_boxes(nodes, link, box, splat4(limit))
            if mask or one_by_one:
                left_link, right_link = get(links, link_at(link, 0)), get(links, link_at(link, 1))
                if one_by_one:
                    left_link, right_link = (
                        left_link if mask & 1 else np.int64(EMPTY),
                        right_link if mask & 2 else np.int64(EMPTY),
                    )
                if mask == 3 or one_by_one:
                    a, b = extract(t_near, 0), extract(t_near, 1)
                    left_first = left_comes_first(order, nodes, links, link, a, b, o, d)
                    put(stack, height, right_link if left_first else left_link)
                    put(entry, height, b if left_first else a)
                    height += 1
                    link = left_link if left_first else right_link
                else:
                    link = left_link if mask == 1 else right_link
                continue
        elif link != EMPTY:  # EMPTY: no such child, or tests are counted and the ray misses it
            leaf = bvh_leaf(link)
            for slot in range(leaf.first, leaf.first + leaf.count):
                prim = get(tree.prim_ids, slot)
                if prim != skip and triangle_hit(tree.corners, slot, ray, o, d, cull_faces, counters):
                    if ignores_hit(hit_filter, ray, tree.corners, slot, prim):
                        continue
                    if order != CLOSEST:
                        return slot, best_t
                    t = hit_t(ray, tree.corners, slot)
                    if best < 0 or comes_first(ray, tree.corners, slot, prim, t, tree.corners, best, best_id, best_t):
                        best, best_id, best_t = slot, prim, t
                        limit = np.float32(best_t * BEYOND)
        while order == CLOSEST and height > 0 and get(entry, height - 1) > limit:
            height -= 1
        if height == 0:
            return best, best_t if best < 0 else rounded_t(ray, tree.corners, best)
        height -= 1
        link = get(stack, height)
        if one_by_one:
            count(counters, BOX_TESTS, 1)
