"""Packets of coherent rays: up to 64 rays traverse a wide BVH together.

Boxes. Ray i meets the plane x = c at t = (c - x0) / d_i + (x0 - o_i) / d_i, for any x0. Over the packet, 1 / d_i and
(x0 - o_i) / d_i are intervals. Interval arithmetic bounds the t at which any ray may enter and leave each of eight
boxes [Boulos et al. 2006]. The second interval is short where all rays are close to x0, so x0 is the first ray's origin
or end.

Traversal. The packet visits inner nodes as a whole. Interval arithmetic finds the boxes that some ray may enter, and
those that all rays enter. For each of the others, a test of sixteen rays at a time finds those that enter it, which are
pushed with the box. Closest-hit queries visit the nearest box first, and repeat this test at leaves, because hits have
shortened rays since. At a leaf, triangles that all lines of the packet miss are culled (`packet_lines`). The loop then
runs over the other triangles or over the rays of a block, whichever are fewer: each triangle is tested against all rays
at once, or each ray against all triangles. So an incoherent packet degrades to single rays.
"""

from typing import NamedTuple

import numpy as np

from ...bvh.nodes import GROUP_WORDS, LINKS, NODE_WORDS, WIDTH, wide_leaf
from ...kernels.exact.filters import FilterTriangles, filter_hits, larger
from ...kernels.jit import I32Ptr, I64Ptr, inlined
from ...kernels.simd import (
    as_f32,
    bits,
    broadcast8,
    broadcast16,
    fma,
    get,
    load8,
    load16,
    lowest_bit,
    mask_from_bits16,
    maximum,
    minimum,
    popcount,
    ptr_at,
    put,
    reduce_max,
    reduce_min,
    select,
    splat8,
    splat16,
    stack_f32,
    stack_i32,
    stack_i64,
    store,
)
from ..counters import BOX_TESTS, NODES, TRIANGLE_TESTS, count
from .packet_extents import (
    first_end,
    first_of,
    greatest_of,
    largest_distance,
    least_of,
    put_extremes,
    rows_at,
    span_of,
    spread_of_ends,
    word_of,
)
from .packet_lines import PacketLines, culled, lines_of, moments_of
from .wide_traversal import (
    BLOCK_WORDS,
    BLOCKS,
    FAR,
    INVERSE,
    LANE,
    LANES,
    LARGE,
    LIMIT,
    LOWER,
    NEAR,
    OX,
    PAD,
    STACK,
    TMIN,
    TURN,
    Query,
    block_of,
    defer,
    enter,
    facing,
    fetch,
    filter_rays16,
    first_block,
    hits_of,
    largest_of,
    rays_in,
    rays_of_block,
    slabs_of,
    sorted_keys,
    visit_leaf,
)

# --- Box tests of a packet --------------------------------------------------------------------------------------------


_TWICE = np.float32(2.0)  # planes are moved twice as far as by `wide_traversal.prepare`, for the roundings of intervals
_INF, _ZERO = np.float32(np.inf), np.float32(0.0)


class Focus(NamedTuple):
    """The point x0 of a packet; scalars."""

    x: np.float32
    y: np.float32
    z: np.float32
    size: np.float32  # largest coordinate magnitude of the point and the origins


class PacketAxis(NamedTuple):
    """A packet's intervals along one axis; scalars."""

    origin: np.float32  # coordinate of x0
    low: np.float32  # least inverse; along a mixed axis, the negative one closest to zero
    high: np.float32  # greatest inverse; along a mixed axis, the positive one closest to zero
    near: np.float32  # least offset of a plane through which rays enter; along a mixed axis, of lower planes
    far: np.float32  # greatest offset of a plane through which rays leave; along a mixed axis, least of upper planes
    word: int  # word in a node of the planes through which rays enter; along a mixed axis, of lower planes
    mixed: bool  # directions differ in sign


class RayPacket(NamedTuple):
    """The intervals of a packet."""

    x: PacketAxis
    y: PacketAxis
    z: PacketAxis
    tmin: np.float32  # least tmin of the rays
    mixed: bool  # along some axis, directions differ in sign
    lines: PacketLines  # by which triangles are culled


@inlined
def _focus_of(rows, rays, extents):
    """The `Focus` of the blocks that hold rays in `rays` (bits), and whether all rays of these blocks start there.

    It is the first origin, or the first end. The end is used if the ends are closer together than the origins, and its
    quotients cannot overflow.
    """
    o = first_of(rows, first_block(rays) * BLOCK_WORDS, OX)
    size = largest_distance(extents.o_low, extents.o_high, (_ZERO, _ZERO, _ZERO))
    spread = largest_distance(extents.o_low, extents.o_high, o)
    if spread > 0.0 and extents.limit < _INF:
        e = first_end(rows, first_block(rays) * BLOCK_WORDS)
        end = larger(larger(abs(e[0]), abs(e[1])), abs(e[2]))
        if end < LARGE and spread_of_ends(rows, rays, e) < spread:
            return Focus(e[0], e[1], e[2], larger(size, end)), False
    return Focus(o[0], o[1], o[2], size), spread == 0.0


@inlined
def _mixed_axis(rows, rays, k, o_low, o_high, pad):
    """(`low`, `high`, `near`, `far`) of `PacketAxis` k, along which directions differ in sign."""
    # In: o_low, o_high, the least and the greatest coordinate of the origins
    backs, fronts = splat16(-_INF), splat16(_INF)
    for j in range(BLOCKS):
        inverse = load16(rows, INVERSE + LANES * k + word_of(rays, j))
        backs = maximum(backs, select(inverse < _ZERO, inverse, splat16(-_INF)))
        fronts = minimum(fronts, select(inverse > _ZERO, inverse, splat16(_INF)))
    back, front = reduce_max(backs), reduce_min(fronts)
    return back, front, -(o_high * front) - pad * front, -(o_low * back) + pad * back


@inlined
def _offsets(rows, rays, k, origin):
    """t from the plane through x0 to the origins along axis k, for the four blocks."""
    start, inverse = rows_at(rows, rays, OX + LANES * k), rows_at(rows, rays, INVERSE + LANES * k)
    return (
        (origin - start[0]) * inverse[0],
        (origin - start[1]) * inverse[1],
        (origin - start[2]) * inverse[2],
        (origin - start[3]) * inverse[3],
    )


@inlined
def _axis(rows, rays, k, extents, origin, offsets, sizes):
    """The `PacketAxis` k of a packet.

    offsets : (least, greatest) of `_offsets`
    sizes : the tree's reach along the axis, and TURN of the largest coordinate of the rays, the tree and x0 on any axis
    """
    low, high, word = extents.inverse_low[k], extents.inverse_high[k], np.int64(2 * WIDTH * k)
    o_low, o_high = extents.o_low[k], extents.o_high[k]
    size = larger(larger(abs(o_low), abs(o_high)), larger(abs(origin), sizes[0]))
    pad = (size * PAD + sizes[1]) * _TWICE
    if low < 0.0 and high > 0.0:
        back, front, near, far = _mixed_axis(rows, rays, k, o_low, o_high, pad)
        return PacketAxis(origin, back, front, near, far, word, True)
    grow = pad * (-low if low < 0 else high)
    word += np.int64(WIDTH) if low < 0 else 0
    return PacketAxis(origin, low, high, offsets[0] - grow, offsets[1] + grow, word, False)


@inlined
def packet_of(tree, rows, rays, extents):
    """The `RayPacket` of those prepared blocks that hold rays in `rays` (bits), from their extents."""
    f, from_one_point = _focus_of(rows, rays, extents)
    x0 = f.x, f.y, f.z
    low, high = (_ZERO, _ZERO, _ZERO, _ZERO), (_ZERO, _ZERO, _ZERO, _ZERO)
    if not from_one_point:
        out = stack_f32(LANES)
        moments = moments_of(rows, rays, x0)
        xs, ys = span_of(_offsets(rows, rays, 0, f.x)), span_of(_offsets(rows, rays, 1, f.y))
        put_extremes(xs, ys, span_of(_offsets(rows, rays, 2, f.z)), (moments, moments), out)
        low, high = least_of(out), greatest_of(out)
    reach = larger(f.size, largest_of(tree.reach))
    turn = reach * TURN
    x = _axis(rows, rays, 0, extents, f.x, (low[0], high[0]), (tree.reach[0], turn))
    y = _axis(rows, rays, 1, extents, f.y, (low[1], high[1]), (tree.reach[1], turn))
    z = _axis(rows, rays, 2, extents, f.z, (low[2], high[2]), (tree.reach[2], turn))
    offset = largest_distance(extents.o_low, extents.o_high, x0)
    lines = lines_of(extents.d_low, extents.d_high, (high[3], offset), x0, reach)
    return RayPacket(x, y, z, extents.tmin, x.mixed or y.mixed or z.mixed, lines)


@inlined
def _times(nodes, at, a):
    """(least, greatest) t at which rays of the packet pass eight planes, the first one at word `at`."""
    planes = load8(nodes, at) - a.origin
    p, q = planes * a.low, planes * a.high
    return minimum(p, q) + a.near, maximum(p, q) + a.far


@inlined
def _slabs(nodes, at, a):
    """Bounds of the t at which rays are between the planes of eight boxes along an axis.

    (earliest entry, latest entry, earliest exit, latest exit)
    """
    if a.mixed:
        lower, upper = load8(nodes, at + a.word), load8(nodes, at + a.word + WIDTH)
        forth, back = fma(lower, splat8(a.high), splat8(a.near)), fma(upper, splat8(a.low), splat8(a.far))
        return maximum(forth, back), splat8(_INF), splat8(-_INF), splat8(_INF)
    first_in, last_in = _times(nodes, at + a.word, a)
    first_out, last_out = _times(nodes, at + (a.word ^ WIDTH), a)
    return first_in, last_in, first_out, last_out


@inlined
def enter_any(nodes, at, packet, limit):
    """Test a node's eight boxes for the rays of a packet and t before `limit`.

    Return (mask of the boxes that any ray may enter, mask of the boxes that all rays enter if their limits allow,
    vector of lower bounds of entry t).
    """
    x, y, z, tmin = packet.x, packet.y, packet.z, packet.tmin
    near_x, x_in, x_out, far_x = _slabs(nodes, at, x)
    near_y, y_in, y_out, far_y = _slabs(nodes, at, y)
    near_z, z_in, z_out, far_z = _slabs(nodes, at, z)
    t_near = maximum(maximum(near_x, near_y), maximum(near_z, splat8(tmin)))
    t_far = minimum(minimum(far_x, far_y), minimum(far_z, splat8(limit)))
    last_in = maximum(maximum(x_in, y_in), maximum(z_in, splat8(tmin)))
    first_out = minimum(minimum(x_out, y_out), minimum(z_out, splat8(limit)))
    return t_near <= t_far, last_in <= first_out, t_near


@inlined
def enter_each(nodes, box, rows):
    """Bits of the rays of a block that enter a box before their limits; box: the word of its first plane.

    All rays enter a missing child, which counts as a leaf without triangles.
    """
    t_near, t_far = load16(rows, TMIN), load16(rows, LIMIT)
    for k in range(3):
        inverse = load16(rows, INVERSE + LANES * k)
        a = broadcast16(nodes, box + 2 * WIDTH * k) * inverse
        b = broadcast16(nodes, box + 2 * WIDTH * k + WIDTH) * inverse
        t_near = maximum(t_near, minimum(a, b) + load16(rows, NEAR + LANES * k))
        t_far = minimum(t_far, maximum(a, b) + load16(rows, FAR + LANES * k))
    return bits(t_near <= t_far)


@inlined
def enter_alike(nodes, box, rows, packet):
    """`enter_each`, faster for a packet whose rays have the same near plane of each slab."""
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
    t_near = maximum(maximum(near_x, near_y), maximum(near_z, load16(r, TMIN)))
    t_far = minimum(minimum(far_x, far_y), minimum(far_z, load16(r, LIMIT)))
    return bits(t_near <= t_far)


# --- Traversal of a packet --------------------------------------------------------------------------------------------


class _Stack(NamedTuple):
    """The stack of a packet: pointers to scratch memory."""

    rays: I64Ptr  # int64 *: bits of the rays that enter the box
    boxes: I32Ptr  # int32 *: word of the box's first plane
    keys: I32Ptr  # int32 *: lower bound of the entry t, as its bits


@inlined
def _entering(tree, rows, active, box, packet, counters):
    """The active rays (bits) that enter a box; box: the word of its first plane."""
    inside, remaining = np.int64(0), active
    while remaining:
        j = first_block(remaining)
        remaining &= ~rays_of_block(j)
        count(counters, BOX_TESTS, 1)
        inside |= enter_alike(tree.nodes, box, ptr_at(rows, j * BLOCK_WORDS), packet) << (j * LANES)
    return inside & active


@inlined
def _push_entered(tree, rows, active, at, packet, limit, any_hit, stack, height, counters):
    """Push the children of a node that active rays enter; for closest-hit, with the nearest one on top."""
    some, each, t_near = enter_any(tree.nodes, at, packet, limit)
    entered, sure, keys = bits(some), bits(each), stack_i32(WIDTH)
    if not any_hit:
        store(keys, 0, sorted_keys(some, t_near))
    for k in range(popcount(entered)):
        lane = lowest_bit(entered)
        entered &= entered - 1
        if not any_hit:
            key = get(keys, k)
            lane = np.int64(key & LANE)
            put(stack.keys, height, key & ~LANE)
        box, all_enter = at + lane, -((sure >> lane) & 1)
        inside = (active & all_enter) | _entering(tree, rows, active & ~all_enter, box, packet, counters)
        put(stack.rays, height, inside)
        put(stack.boxes, height, box)
        fetch(tree, get(tree.links, box + LINKS))
        height += inside != 0  # branchless, because a branch would often be mispredicted
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
        fetch(tree, get(tree.links, box + LINKS))
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
def _keep_nearest(rays, lanes, at, near, far, hits):
    """Store the hits on the triangle in lane `at` of the rays that meet it (`lanes`, bits), and defer rivals."""
    rows, met = rays.rows, mask_from_bits16(lanes)
    lower, limit = load16(rows, LOWER), load16(rows, LIMIT)
    nearest = met & (far < lower)
    store(hits.lane, 0, select(nearest, splat16(np.int32(at)), load16(hits.lane, 0)))
    store(rows, LOWER, select(met, minimum(lower, near), lower))
    store(rows, LIMIT, select(met, minimum(limit, far), limit))
    rivals = bits(met & ~nearest & (near <= limit))
    if rivals:
        defer(hits, rivals, at)


class _Leaf(NamedTuple):
    """A leaf, and those of its triangles that a packet may meet."""

    at: int  # link
    triangles: int  # bits


@inlined
def _leaf_by_triangle(tree, rays, active, leaf, query, hits, counters):
    """Test triangles of a leaf against all active rays. Return bits of the rays that any-hit finds blocked."""
    group, triangles, done = wide_leaf(leaf.at).group, leaf.triangles, 0
    while triangles:
        k = lowest_bit(triangles)
        triangles &= triangles - 1
        todo = active & ~done
        count(counters, TRIANGLE_TESTS, popcount(todo))
        at = group * WIDTH + k
        tests = filter_hits(filter_rays16(rays.rows), _triangle(tree.groups, group * GROUP_WORDS + k))
        lanes = facing(tests.hits, tests.positive, query.cull_faces) & todo
        unsure = tests.unsure & todo
        if lanes:
            prim = get(tree.prim_ids, get(tree.slots, at))
            lanes &= bits(load16(rays.skip, 0) != prim)
            if query.any_hit:
                done |= lanes
            else:
                _keep_nearest(rays, lanes, at, tests.near, tests.far, hits)
        if unsure:
            defer(hits, unsure, at)
        if done == active:
            break
    return done


@inlined
def _leaf_by_ray(tree, rays, active, leaf, query, hits, counters):
    """Test each active ray against all triangles of a leaf. Return the same as `_leaf_by_triangle`."""
    done = 0
    while active:
        i = lowest_bit(active)
        active &= active - 1
        if visit_leaf(tree, rays, i, leaf.at, query, hits, counters):
            done |= 1 << i
    return done


@inlined
def _leaf(tree, rays, active, leaf, query, hits, counters):
    """Test a leaf against the active rays. Return bits of the rays that any-hit finds blocked."""
    if popcount(active) < popcount(leaf.triangles):
        return _leaf_by_ray(tree, rays, active, leaf, query, hits, counters)
    return _leaf_by_triangle(tree, rays, active, leaf, query, hits, counters)


@inlined
def _met_leaf(tree, link, active, lines):
    """The `_Leaf` of a link; if several rays are active, without the triangles that none on these lines meets."""
    group, n = wide_leaf(link)
    triangles = np.int64((1 << n) - 1)
    if active & (active - 1) != 0:
        triangles &= ~culled(tree.groups, group * GROUP_WORDS, lines)
    return _Leaf(link, triangles)


@inlined
def _leaf_of_blocks(tree, rays, active, leaf, query, hits, counters):
    """`_leaf` for the active rays of several blocks of a packet."""
    done = 0
    while active and leaf.triangles != 0:
        j = first_block(active)
        mine, block = rays_in(active, j), block_of(rays, j)
        active &= ~rays_of_block(j)
        done |= _leaf(tree, block, mine, leaf, query, hits_of(hits, j), counters) << (j * LANES)
    return done


@inlined
def _walk_any(tree, rays, alive, packet, query, hits, counters):
    """Trace the rays in `alive`, of several blocks. Return bits of the blocked rays."""
    stack, rows = _Stack(stack_i64(STACK), stack_i32(STACK), stack_i32(1)), rays.rows
    packet, limit = packet
    height, link, blocked, active = 0, 0, 0, alive
    while True:
        if link < 0:
            leaf = _met_leaf(tree, link, active, packet.lines)
            blocked |= _leaf_of_blocks(tree, rays, active, leaf, query, hits, counters)
            if blocked == alive:
                return blocked
        else:
            count(counters, NODES, 1)
            count(counters, BOX_TESTS, WIDTH)
            at = link * NODE_WORDS
            if active & (active - 1) == 0:
                height = _push_entered_by_one(tree, rows, active, at, stack, height)
            else:
                height = _push_entered(tree, rows, active, at, packet, limit, True, stack, height, counters)
        active = np.int64(0)
        while active == 0:
            if height == 0:
                return blocked
            height -= 1
            active = get(stack.rays, height) & ~blocked
        link = get(tree.links, get(stack.boxes, height) + LINKS)


@inlined
def _greatest_limit(rows, alive):
    """The greatest limit of the blocks that hold rays in `alive` (bits)."""
    limits = splat16(-_INF)
    while alive:
        j = first_block(alive)
        alive &= ~rays_of_block(j)
        limits = maximum(limits, load16(rows, LIMIT + j * BLOCK_WORDS))
    return reduce_max(limits)


@inlined
def _walk_nearest(tree, rays, alive, packet, query, hits, counters):
    """Trace the rays in `alive`, of several blocks, and write their nearest hits to `hits`."""
    stack, rows = _Stack(stack_i64(STACK), stack_i32(STACK), stack_i32(STACK)), rays.rows
    packet, limit = packet
    height, link, box, active = np.int64(0), np.int64(0), np.int64(0), alive
    while True:
        if link < 0:
            active = _entering(tree, rows, active, box, packet, counters)
            if active:
                leaf = _met_leaf(tree, link, active, packet.lines)
                _leaf_of_blocks(tree, rays, active, leaf, query, hits, counters)
                limit = _greatest_limit(rows, alive)
        else:
            count(counters, NODES, 1)
            count(counters, BOX_TESTS, WIDTH)
            at = link * NODE_WORDS
            height = _push_entered(tree, rows, active, at, packet, limit, False, stack, height, counters)
        while height > 0 and get(as_f32(stack.keys), height - 1) > limit:
            height -= 1
        if height == 0:
            return
        height -= 1
        active, box = get(stack.rays, height), np.int64(get(stack.boxes, height))
        link = np.int64(get(tree.links, box + LINKS))


@inlined
def walk_packet(tree, rays, alive, packet, query, hits, counters):
    """Trace the rays in `alive` (bits) of several blocks, a coherent packet of up to 64.

    Any-hit queries return bits of the blocked rays. Closest-hit queries write `hits` as `walk_interleaved` does, block
    by block.

    packet : its `RayPacket`, and the greatest limit
    """
    if query.any_hit:
        return _walk_any(tree, rays, alive, packet, Query(query.cull_faces, True), hits, counters)
    _walk_nearest(tree, rays, alive, packet, Query(query.cull_faces, False), hits, counters)
    return np.int64(0)
