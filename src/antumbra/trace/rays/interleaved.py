"""Interleaved rays: incoherent rays take turns, and each takes one step down the wide BVH, a node or a leaf.

A single ray waits for memory at nearly every step, because each step decides which node comes next. So a step
prefetches the node that its ray visits next. The node is in the cache when the ray's turn comes again. All rays share
only the first step. Any-hit queries take it together, one ray to a lane.
"""

import numpy as np

from ...bvh.wide import LINKS, NO_CHILD, NODE_WORDS, WIDTH
from ...kernels.jit import inlined, kernel
from ...kernels.simd import (
    bits,
    broadcast8,
    get,
    load8,
    lowest_bit,
    mask_from_bits8,
    mask_from_bits16,
    popcount,
    ptr_at,
    put,
    select,
    splat16,
    stack_f32,
    stack_f64,
    stack_i32,
    stack_i64,
    store,
    store_compressed,
)
from ..counters import BOX_TESTS, NODES, count
from .packetbox import enter_each
from .rayblock import BLOCK_WORDS, DX, ENDS, LANES, LIMIT, OX, PRECISE_WORDS, REST, TMAX, TMIN, WAY, RayBlock, prepare
from .wide import (
    DEFERRED_WORDS,
    STACK,
    Query,
    WideHit,
    enter,
    fetch,
    push_sorted,
    settle_block,
    slabs_of,
    slot_of,
    start,
    visit_leaf,
)

_STACKS = LANES * STACK


@inlined
def _open_node(tree, rays, i, link, query, stack, entry, height, nears, counters):
    """Push the children that ray i enters, the first one to visit on top. Return the new height."""
    count(counters, NODES, 1)
    count(counters, BOX_TESTS, WIDTH)
    at = link * NODE_WORDS
    entered, near = enter(tree.nodes, at, slabs_of(rays.rows, i), broadcast8(rays.rows, LIMIT + i))
    hits = bits(entered)
    if query.any_hit:
        store_compressed(stack, height, mask_from_bits8(hits), load8(tree.links, at + LINKS))
        return height + popcount(hits)
    store(nears, 0, near)
    return push_sorted(stack, entry, height, ptr_at(tree.links, at + LINKS), nears, hits)


@inlined
def _open_root(tree, rays, alive, stacks, heights, counters):
    """For any-hit, push the root's children that each ray enters, all rays at once. Return bits of rays that enter."""
    entered, n = splat16(np.int32(0)), 0
    while n < WIDTH and get(tree.links, LINKS + n) != NO_CHILD:
        inside = mask_from_bits16(enter_each(tree.nodes, n, rays.rows))
        entered |= select(inside, splat16(np.int32(1 << n)), splat16(np.int32(0)))
        n += 1
    count(counters, NODES, 1)
    count(counters, BOX_TESTS, n)
    hits, links = stack_i32(LANES), load8(tree.links, LINKS)
    store(hits, 0, entered)
    alive &= bits(entered != splat16(np.int32(0)))
    turn = alive
    while turn:
        i = lowest_bit(turn)
        turn &= turn - 1
        inside = np.int64(get(hits, i))
        height = popcount(inside)
        store_compressed(stacks, i * STACK, mask_from_bits8(inside), links)
        put(heights, i, height)
        fetch(tree, np.int64(get(stacks, i * STACK + height - 1)))
    return alive


@inlined
def walk_interleaved(tree, rays, alive, query, found, counters):
    """Trace the rays in `alive` (bits) of a prepared block, and write their hits, any or nearest, to `found`."""
    stacks, entries, heights = stack_i32(_STACKS), stack_f32(_STACKS), stack_i32(LANES)
    nears = stack_f32(WIDTH)
    if query.any_hit and alive & (alive - 1):  # two or more rays
        alive = _open_root(tree, rays, alive, stacks, heights, counters)
    else:
        for i in range(LANES):
            put(heights, i, 1)
            put(stacks, i * STACK, 0)
            put(entries, i * STACK, 0.0)
    while alive:
        turn = alive
        while turn:
            i = lowest_bit(turn)
            turn &= turn - 1
            stack, entry = ptr_at(stacks, i * STACK), ptr_at(entries, i * STACK)
            height = np.int64(get(heights, i)) - 1
            link = np.int64(get(stack, height))
            if link >= 0:
                height = _open_node(tree, rays, i, link, query, stack, entry, height, nears, counters)
            elif visit_leaf(tree, rays, i, link, query, found, counters):
                height = np.int64(0)
            while not query.any_hit and height > 0 and get(entry, height - 1) > get(rays.rows, LIMIT + i):
                height -= 1
            if height == 0:
                alive &= ~(1 << i)
            else:
                put(heights, i, height)
                fetch(tree, np.int64(get(stack, height - 1)))


@kernel
def any_hit_wide(tree, ray, skip, cull_faces, counters):
    """Slot of a triangle that a segment meets, or -1."""
    rows, precise, skips = stack_f32(BLOCK_WORDS), stack_f64(PRECISE_WORDS), stack_i32(LANES)
    f = np.float32
    store(rows, OX, splat16(f(ray.ox)))
    store(rows, OX + LANES, splat16(f(ray.oy)))
    store(rows, OX + 2 * LANES, splat16(f(ray.oz)))
    store(rows, DX, splat16(f(ray.dx)))
    store(rows, DX + LANES, splat16(f(ray.dy)))
    store(rows, DX + 2 * LANES, splat16(f(ray.dz)))
    store(rows, TMIN, splat16(f(ray.tmin)))
    store(rows, TMAX, splat16(f(ray.tmax)))
    put(precise, ENDS, ray.tmin)
    put(precise, ENDS + LANES, ray.tmax)
    put(precise, WAY, ray.dx)
    put(precise, WAY + LANES, ray.dy)
    put(precise, WAY + 2 * LANES, ray.dz)
    put(precise, REST, ray.rx)
    put(precise, REST + LANES, ray.ry)
    put(precise, REST + 2 * LANES, ray.rz)
    put(skips, 0, skip)
    found = WideHit(stack_i32(LANES), stack_i64(LANES), stack_f64(LANES), stack_i32(DEFERRED_WORDS))
    prepare(rows, tree.reach)
    block, query = RayBlock(rows, precise, skips, True), Query(cull_faces, True)
    start(found, block)
    walk_interleaved(tree, block, np.int64(1), query, found, counters)
    if get(found.deferred, 0) > 0:
        settle_block(tree, block, query, found, counters)
    return slot_of(tree, found, 0)
