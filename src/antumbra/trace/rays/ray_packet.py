"""Packets of coherent rays: up to 64 any-hit or 16 closest-hit rays traverse a wide BVH together.

Boxes. Ray i meets the plane x = c at t = (c - x0) / d_i + (x0 - o_i) / d_i, for any x0. Over the packet, 1 / d_i and
(x0 - o_i) / d_i are intervals. Interval arithmetic bounds the t at which any ray may enter and leave each of eight
boxes [Boulos et al. 2006]. The second interval is short where all rays are close to x0. So x0 is the first ray's origin
or end.

Traversal. The packet visits inner nodes as a whole. Interval arithmetic bounds the t at which any of its rays may enter
each of eight boxes. It also tells boxes that all rays enter. For each other box left, any-hit queries test which rays
enter it, sixteen at a time. They push these rays with the box. Closest-hit queries make this test at leaves. At a leaf,
the loop is over the triangles or over the rays of a block, whichever are fewer. Each triangle is tested against all
rays at once, or each ray against all triangles. So a packet that falls apart ends as single rays.
"""

from typing import NamedTuple

import numpy as np

from ...bvh.nodes import GROUP_WORDS, LINKS, NODE_WORDS, WIDTH, wide_leaf
from ...kernels.exact.filters import FilterTriangles, meet
from ...kernels.jit import I32Ptr, I64Ptr, inlined
from ...kernels.simd import (
    absolute,
    all_lanes,
    bits,
    broadcast8,
    broadcast16,
    extract,
    fma,
    get,
    iota8,
    load8,
    load16,
    lowest_bit,
    maximum,
    minimum,
    popcount,
    ptr_at,
    put,
    reduce_max,
    reduce_min,
    splat8,
    splat16,
    stack_f32,
    stack_i32,
    stack_i64,
    store,
)
from ..counters import BOX_TESTS, NODES, TRIANGLE_TESTS, count
from .wide_traversal import (
    BLOCK_WORDS,
    DX,
    FAR,
    INVERSE,
    LANES,
    LARGE,
    LIMIT,
    NEAR,
    OX,
    STACK,
    TMIN,
    UNIT,
    Query,
    block_of,
    defer,
    enter,
    facing,
    fetch,
    filter_rays16,
    first_block,
    hits_of,
    keep,
    push_sorted,
    rays_in,
    rays_of_block,
    slabs_of,
    visit_leaf,
)

# --- A packet of coherent rays against boxes: all rays at once by interval arithmetic, or each of sixteen rays --------
#
# Ray i meets the plane x = c at t = (c - x0) / d_i + (x0 - o_i) / d_i, for any x0. Over the packet, 1 / d_i and (x0 -
# o_i) / d_i are intervals. Interval arithmetic bounds the t at which any ray may enter and leave each of eight boxes
# [Boulos et al. 2006]. The second interval is short where all rays are close to x0. So x0 is the first ray's origin or
# end.


_PAD = np.float32(2.0**-19)  # moves planes outwards as `rayblock.prepare` does, for the roundings of intervals
_INF = np.float32(np.inf)


class Focus(NamedTuple):
    """The point x0 of a packet; scalars."""

    x: np.float32
    y: np.float32
    z: np.float32
    size: np.float32  # largest magnitude of a coordinate of the point and of the origins


class PacketAxis(NamedTuple):
    """A packet's intervals along one axis; scalars."""

    origin: np.float32  # coordinate of x0
    low: np.float32  # least inverse; 0 if the inverses differ in sign, and then the axis does not restrict t
    high: np.float32  # greatest inverse; 0 in the same case
    near: np.float32  # least offset of a plane through which rays enter
    far: np.float32  # greatest offset of a plane through which rays leave
    word: int  # word in a node of the planes through which rays enter


class RayPacket(NamedTuple):
    """The intervals of a packet."""

    x: PacketAxis
    y: PacketAxis
    z: PacketAxis
    tmin: np.float32  # least tmin of the rays
    mixed: bool  # along some axis, rays go both ways


@inlined
def _end(rows, at, k):
    """Coordinate k of the ends of the rays of the block at word `at`."""
    return fma(load16(rows, DX + LANES * k + at), load16(rows, LIMIT + at), load16(rows, OX + LANES * k + at))


@inlined
def _focus_of(rows, alive):
    """The `Focus` of the blocks that hold the rays in `alive` (bits): the first origin, or else the first end.

    It is the end where ends are closer together than origins are, and no quotient of it can overflow.
    """
    first = first_block(alive) * BLOCK_WORDS
    starts, ends, sizes = splat16(np.float32(0.0)), splat16(np.float32(0.0)), splat16(np.float32(0.0))
    x, y, z = get(rows, first + OX), get(rows, first + OX + LANES), get(rows, first + OX + 2 * LANES)
    ex, ey, ez = extract(_end(rows, first, 0), 0), extract(_end(rows, first, 1), 0), extract(_end(rows, first, 2), 0)
    o, e = (x, y, z), (ex, ey, ez)
    while alive:
        j = first_block(alive)
        alive &= ~rays_of_block(j)
        for k in range(3):
            start = load16(rows, OX + LANES * k + j * BLOCK_WORDS)
            sizes, starts = maximum(sizes, absolute(start)), maximum(starts, absolute(start - o[k]))
            ends = maximum(ends, absolute(_end(rows, j * BLOCK_WORDS, k) - e[k]))
    size, end = reduce_max(sizes), max(max(abs(ex), abs(ey)), abs(ez))
    if end < LARGE and reduce_max(ends) < reduce_max(starts):  # false too for rays without end
        return Focus(ex, ey, ez, max(size, end))
    return Focus(x, y, z, size)


@inlined
def _axis(rows, alive, k, origin, reach):
    """The `PacketAxis` k of a packet whose coordinates, with the tree's and `origin`, are at most `reach`."""
    lows, highs, nears, fars = splat16(_INF), splat16(-_INF), splat16(_INF), splat16(-_INF)
    while alive:
        j = first_block(alive)
        alive &= ~rays_of_block(j)
        b = j * BLOCK_WORDS + LANES * k
        inverse = load16(rows, INVERSE + b)
        offset = (splat16(origin) - load16(rows, OX + b)) * inverse
        lows, highs = minimum(lows, inverse), maximum(highs, inverse)
        nears, fars = minimum(nears, offset), maximum(fars, offset)
    low, high = reduce_min(lows), reduce_max(highs)
    if low < 0.0 and high > 0.0:  # the axis does not restrict t
        zero = np.float32(0.0)
        return PacketAxis(origin, zero, zero, -_INF, _INF, np.int64(2 * WIDTH * k))
    grow = _PAD * reach * (-low if low < 0 else high)
    word = np.int64(2 * WIDTH * k) + (np.int64(WIDTH) if low < 0 else np.int64(0))
    return PacketAxis(origin, low, high, reduce_min(nears) - grow, reduce_max(fars) + grow, word)


@inlined
def packet_of(tree, rows, alive):
    """(`Packet`, greatest limit) of the blocks that hold the rays in `alive` (bits), of several prepared blocks."""
    tmins, limits, left = splat16(_INF), splat16(-_INF), alive
    while left:
        j = first_block(left)
        left &= ~rays_of_block(j)
        b = j * BLOCK_WORDS
        tmins, limits = minimum(tmins, load16(rows, TMIN + b)), maximum(limits, load16(rows, LIMIT + b))
    f = _focus_of(rows, alive)
    reach = max(f.size, np.float32(tree.reach))
    x, y, z = _axis(rows, alive, 0, f.x, reach), _axis(rows, alive, 1, f.y, reach), _axis(rows, alive, 2, f.z, reach)
    mixed = x.high * x.low <= 0.0 or y.high * y.low <= 0.0 or z.high * z.low <= 0.0
    return RayPacket(x, y, z, reduce_min(tmins), mixed), reduce_max(limits)


@inlined
def _times(nodes, at, origin, a):
    """(least, greatest) t at which rays of the packet pass eight planes, the first one at word `at`."""
    planes = load8(nodes, at) - origin
    p, q = planes * a.low, planes * a.high
    return minimum(p, q) + a.near, maximum(p, q) + a.far


@inlined
def enter_any(nodes, at, packet, limit):
    """Test a node's eight boxes for the rays of a packet and t before `limit`.

    Return a mask of the boxes that any ray may enter, one of boxes that all rays enter as long as they last, and a
    vector of lower bounds of entry t.
    """
    x, y, z, tmin, _ = packet
    near_x, x_in = _times(nodes, at + x.word, x.origin, x)
    near_y, y_in = _times(nodes, at + y.word, y.origin, y)
    near_z, z_in = _times(nodes, at + z.word, z.origin, z)
    x_out, far_x = _times(nodes, at + (x.word ^ WIDTH), x.origin, x)
    y_out, far_y = _times(nodes, at + (y.word ^ WIDTH), y.origin, y)
    z_out, far_z = _times(nodes, at + (z.word ^ WIDTH), z.origin, z)
    near = maximum(maximum(near_x, near_y), maximum(near_z, splat8(tmin)))
    far = minimum(minimum(far_x, far_y), minimum(far_z, splat8(limit)))
    last_in = maximum(maximum(x_in, y_in), maximum(z_in, splat8(tmin)))
    first_out = minimum(minimum(x_out, y_out), minimum(z_out, splat8(limit)))
    return near <= far, last_in <= first_out, near


@inlined
def enter_each(nodes, box, rows):
    """Bits of the rays of a block that enter a box before their limits; box: the word of its first plane.

    All rays enter a missing child, which is a leaf without triangles.
    """
    near, far = load16(rows, TMIN), load16(rows, LIMIT)
    for k in range(3):
        inverse = load16(rows, INVERSE + LANES * k)
        a = broadcast16(nodes, box + 2 * WIDTH * k) * inverse
        b = broadcast16(nodes, box + 2 * WIDTH * k + WIDTH) * inverse
        near = maximum(near, minimum(a, b) + load16(rows, NEAR + LANES * k))
        far = minimum(far, maximum(a, b) + load16(rows, FAR + LANES * k))
    return bits(near <= far)


@inlined
def enter_alike(nodes, box, rows, packet):
    """`enter_each` for a packet whose rays agree, along each axis, which of two planes is the near one."""
    if packet.mixed:
        return enter_each(nodes, box, rows)
    r, (x, y, z) = rows, (box + packet.x.word, box + packet.y.word, box + packet.z.word)
    ix, iy, iz = load16(r, INVERSE), load16(r, INVERSE + LANES), load16(r, INVERSE + 2 * LANES)
    near_x = fma(broadcast16(nodes, x), ix, load16(r, NEAR))
    near_y = fma(broadcast16(nodes, y), iy, load16(r, NEAR + LANES))
    near_z = fma(broadcast16(nodes, z), iz, load16(r, NEAR + 2 * LANES))
    far_x = fma(broadcast16(nodes, x ^ WIDTH), ix, load16(r, FAR))
    far_y = fma(broadcast16(nodes, y ^ WIDTH), iy, load16(r, FAR + LANES))
    far_z = fma(broadcast16(nodes, z ^ WIDTH), iz, load16(r, FAR + 2 * LANES))
    near = maximum(maximum(near_x, near_y), maximum(near_z, load16(r, TMIN)))
    far = minimum(minimum(far_x, far_y), minimum(far_z, load16(r, LIMIT)))
    return bits(near <= far)


# --- Rays that run close together, through a wide BVH as one: up to 64 for any-hit, sixteen for closest-hit -----------
#
# The packet visits inner nodes as a whole. `packetbox` bounds the t at which any of its rays may enter each of eight
# boxes. It also tells boxes that all rays enter. For each other box left, any-hit queries test which rays enter it,
# sixteen at a time. They push these rays with the box. Closest-hit queries make this test at leaves. At a leaf, the
# loop is over the triangles or over the rays of a block, whichever are fewer. Each triangle is tested against all rays
# at once, or each ray against all triangles. So a packet that falls apart ends as single rays.


_NEAR_ENDS = np.float32(1 / 32)  # largest extent of a packet's origins, or of its ends, as a share of the tree's reach
_NEAR_DIRECTIONS = np.float32(1 / 4)  # largest extent of its directions, as a share of their largest component


class _Stack(NamedTuple):
    """The boxes that any-hit rays wait for: pointers to scratch memory."""

    rays: I64Ptr  # int64 *: bits of the rays that enter the box
    boxes: I32Ptr  # int32 *: word of its first plane


@inlined
def runs_along(rows, first, j, tree_reach, any_hit):
    """Is it faster to trace the sixteen rays of prepared block j in a packet that begins with block `first`?

    Rays of a packet start close together and run in about one direction. They start within a 32nd of the tree's reach
    from the packet's first ray. Components of their directions differ from its own by at most a quarter of its largest
    one. Any-hit segments only need to end close together.
    """
    a, b = first * BLOCK_WORDS, j * BLOCK_WORDS
    near, limit = splat16(_NEAR_ENDS * tree_reach), load16(rows, LIMIT + b)
    widest, first_limit = np.float32(0.0), get(rows, LIMIT + a)
    for k in range(3):
        size = abs(get(rows, DX + LANES * k + a))
        widest = size if size > widest else widest
    turn = splat16(_NEAR_DIRECTIONS * widest)
    tame = load16(rows, UNIT + b) < np.float32(np.inf)
    start, stop = tame, tame if any_hit else ~tame & tame
    for k in range(3):
        o, d = load16(rows, OX + LANES * k + b), load16(rows, DX + LANES * k + b)
        o0, d0 = get(rows, OX + LANES * k + a), get(rows, DX + LANES * k + a)
        start &= (absolute(o - o0) <= near) & (absolute(d - d0) <= turn)
        stop &= absolute(fma(d, limit, o) - (d0 * first_limit + o0)) <= near
    return all_lanes(start) or all_lanes(stop)


@inlined
def _push_entered(tree, rows, active, at, packet, limit, stack, height, counters):
    """Push the children of the node at word `at` that active rays enter: bits of the rays, and the box."""
    some, each, _ = enter_any(tree.nodes, at, packet, limit)
    hits, sure = bits(some), bits(each)
    while hits:
        k = lowest_bit(hits)
        box = at + k
        hits &= hits - 1
        inside = active & -((sure >> k) & 1)
        left = active & ~inside
        while left:
            j = first_block(left)
            left &= ~rays_of_block(j)
            count(counters, BOX_TESTS, 1)
            inside |= enter_alike(tree.nodes, box, ptr_at(rows, j * BLOCK_WORDS), packet) << (j * LANES)
        inside &= active
        put(stack.rays, height, inside)
        put(stack.boxes, height, box)
        fetch(tree, np.int64(get(tree.links, box + LINKS)))
        height += inside != 0  # without a branch, which often goes another way than predicted
    return height


@inlined
def _push_entered_by_one(tree, rows, active, at, stack, height):
    """`_push_entered` for a single active ray."""
    ray = lowest_bit(active)
    i, block = ray & (LANES - 1), ptr_at(rows, (ray // LANES) * BLOCK_WORDS)
    hits = bits(enter(tree.nodes, at, slabs_of(block, i), broadcast8(block, LIMIT + i))[0])
    while hits:
        box = at + lowest_bit(hits)
        hits &= hits - 1
        fetch(tree, np.int64(get(tree.links, box + LINKS)))
        put(stack.rays, height, active)
        put(stack.boxes, height, box)
        height += 1
    return height


@inlined
def _triangle(groups, at):
    """The `FilterTriangles` of one triangle, whose first word is `at`, in all lanes."""
    b = groups
    return FilterTriangles(
        broadcast16(b, at), broadcast16(b, at + 8), broadcast16(b, at + 16), broadcast16(b, at + 24),
        broadcast16(b, at + 32), broadcast16(b, at + 40), broadcast16(b, at + 48), broadcast16(b, at + 56),
        broadcast16(b, at + 64), broadcast16(b, at + 72),
    )  # fmt: skip


@inlined
def _keep_each(tree, rays, hits, at, query, found):
    """Keep the triangle in lane `at` for the rays that meet it (bits)."""
    while hits:
        i = lowest_bit(hits)
        hits &= hits - 1
        keep(tree, rays, i, at, query, found)


@inlined
def _leaf_by_triangle(tree, rays, active, link, query, found, counters):
    """Test each triangle of a leaf against all active rays. Return bits of the rays whose any-hit query is answered."""
    (group, n), done = wide_leaf(link), np.int64(0)
    for k in range(n):
        todo = active & ~done
        count(counters, TRIANGLE_TESTS, popcount(todo))
        at = group * WIDTH + k
        hits, positive, unsure = meet(filter_rays16(rays.rows), _triangle(tree.groups, group * GROUP_WORDS + k))
        hits = facing(hits, positive, query.cull_faces) & todo
        unsure &= todo
        if query.any_hit and hits:
            prim = get(tree.prim_ids, get(tree.slots, at))
            done |= hits & bits(load16(rays.skip, 0) != prim)
        elif hits:
            _keep_each(tree, rays, hits, at, query, found)
        if unsure:
            defer(found, unsure, at)
        if done == active:
            break
    return done


@inlined
def _leaf_by_ray(tree, rays, active, link, query, found, counters):
    """Test each active ray against all triangles of a leaf. Return the same as `_leaf_by_triangle`."""
    done = np.int64(0)
    while active:
        i = lowest_bit(active)
        active &= active - 1
        if visit_leaf(tree, rays, i, link, query, found, counters):
            done |= 1 << i
    return done


@inlined
def _leaf(tree, rays, active, link, query, found, counters):
    """Test a leaf against the active rays. Return bits of the rays whose any-hit query is answered."""
    if popcount(active) < wide_leaf(link).count:
        return _leaf_by_ray(tree, rays, active, link, query, found, counters)
    return _leaf_by_triangle(tree, rays, active, link, query, found, counters)


@inlined
def _leaf_of_blocks(tree, rays, active, link, query, found, counters):
    """`_leaf` for the active rays of several blocks."""
    done = np.int64(0)
    while active:
        j = first_block(active)
        mine, block = rays_in(active, j), block_of(rays, j)
        active &= ~rays_of_block(j)
        done |= _leaf(tree, block, mine, link, query, hits_of(found, j), counters) << (j * LANES)
    return done


@inlined
def _walk_any(tree, rays, alive, query, found, counters):
    """Trace the rays in `alive`, of several blocks. Return bits of the blocked rays."""
    stack, rows = _Stack(stack_i64(STACK), stack_i32(STACK)), rays.rows
    packet, limit = packet_of(tree, rows, alive)
    height, link, blocked, active = np.int64(0), np.int64(0), np.int64(0), alive
    while True:
        if link < 0:
            blocked |= _leaf_of_blocks(tree, rays, active, link, query, found, counters)
            if blocked == alive:
                return blocked
        else:
            count(counters, NODES, 1)
            count(counters, BOX_TESTS, WIDTH)
            if active & (active - 1) == 0:
                height = _push_entered_by_one(tree, rows, active, link * NODE_WORDS, stack, height)
            else:
                height = _push_entered(tree, rows, active, link * NODE_WORDS, packet, limit, stack, height, counters)
        active = np.int64(0)
        while active == 0:
            if height == 0:
                return blocked
            height -= 1
            active = get(stack.rays, height) & ~blocked
        link = np.int64(get(tree.links, np.int64(get(stack.boxes, height)) + LINKS))


@inlined
def _walk_nearest(tree, rays, alive, query, found, counters):
    """Trace the rays in `alive`, and write their nearest hits to `found`."""
    stack, entry, nears, children = stack_i32(STACK), stack_f32(STACK), stack_f32(WIDTH), stack_i32(WIDTH)
    rows = rays.rows
    packet, limit = packet_of(tree, rows, np.int64(1))
    height, link, box = np.int64(0), np.int64(0), np.int64(0)
    while True:
        if link < 0:
            count(counters, BOX_TESTS, 1)
            active = alive & enter_alike(tree.nodes, box, rows, packet)
            if active:
                _leaf(tree, rays, active, link, query, found, counters)
                limit = reduce_max(load16(rows, LIMIT))
        else:
            count(counters, NODES, 1)
            count(counters, BOX_TESTS, WIDTH)
            entered, _, near = enter_any(tree.nodes, link * NODE_WORDS, packet, limit)
            store(nears, 0, near)
            store(children, 0, iota8() + np.int32(link * NODE_WORDS))
            height = push_sorted(stack, entry, height, children, nears, bits(entered))
        while height > 0 and get(entry, height - 1) > limit:
            height -= 1
        if height == 0:
            return
        height -= 1
        box = np.int64(get(stack, height))
        link = np.int64(get(tree.links, box + LINKS))


@inlined
def walk_packet(tree, rays, alive, query, found, counters):
    """Trace the rays in `alive` (bits) of several blocks, a coherent packet of up to 64.

    For any-hit queries, return bits of the blocked rays. For closest-hit queries, write `found` as `walk_interleaved`
    does, one block after the other.
    """
    if query.any_hit:
        return _walk_any(tree, rays, alive, Query(query.cull_faces, True), found, counters)
    nearest = Query(query.cull_faces, False)
    while alive:
        j = first_block(alive)
        _walk_nearest(tree, block_of(rays, j), rays_in(alive, j), nearest, hits_of(found, j), counters)
        alive &= ~rays_of_block(j)
    return np.int64(0)
