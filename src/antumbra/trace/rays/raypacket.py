"""Rays that run close together, through a wide BVH as one: up to 64 for any-hit, sixteen for closest-hit.

The packet visits inner nodes as a whole. `packetbox` bounds the t at which any of its rays may enter each of eight
boxes. It also tells boxes that all rays enter. For each other box left, any-hit queries test which rays enter it,
sixteen at a time. They push these rays with the box. Closest-hit queries make this test at leaves. At a leaf, the loop
is over the triangles or over the rays of a block, whichever are fewer. Each triangle is tested against all rays at
once, or each ray against all triangles. So a packet that falls apart ends as single rays.
"""

from typing import NamedTuple

import numpy as np

from ...bvh.links import wide_leaf
from ...bvh.wide import GROUP_WORDS, LINKS, NODE_WORDS, WIDTH
from ...kernels.fields import I32Ptr, I64Ptr
from ...kernels.jit import inlined
from ...kernels.predicate.vector_filters import FilterTriangles, meet
from ...kernels.simd import (
    absolute,
    all_lanes,
    bits,
    broadcast8,
    broadcast16,
    fma,
    get,
    iota8,
    load16,
    lowest_bit,
    popcount,
    ptr_at,
    put,
    reduce_max,
    splat16,
    stack_f32,
    stack_i32,
    stack_i64,
    store,
)
from ..counters import BOX_TESTS, NODES, TRIANGLE_TESTS, count
from .packetbox import enter_alike, enter_any, packet_of
from .rayblock import (
    BLOCK_WORDS,
    DX,
    LANES,
    LIMIT,
    OX,
    UNIT,
    block_of,
    filter_rays16,
    first_block,
    rays_in,
    rays_of_block,
)
from .wide import STACK, Query, defer, enter, facing, fetch, hits_of, keep, push_sorted, slabs_of, visit_leaf

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
