"""Interleaved rays in the wide BVH, for incoherent rays.

A ray alone stalls at nearly every step, on memory or on a mispredicted branch, because each step determines the next.
So up to 64 rays advance in rounds. A round has four loops: rays at inner nodes push the children that they enter; rays
at leaves test eight triangles; those that may hit one store their hits; each ray then pops its next node or leaf, and
prefetches it. Except for the third, these loops contain no branch that depends on a ray, so that the processor works on
several rays at a time.

Any-hit rays push the links of their children in the order of the node. Closest-hit rays push a key and a link for each
child: all eight are sorted and stored, and those whose boxes are not entered end up beyond the top of the stack. To
pop, a ray compares its top eight keys with its limit.
"""

from typing import NamedTuple

import numpy as np

from ...bvh.nodes import GROUP_WORDS, LINKS, NODE_WORDS, WIDTH, wide_leaf
from ...kernels.exact.filters import filter_hits_branchless
from ...kernels.jit import F32Ptr, I32Ptr, inlined, overload
from ...kernels.simd import (
    as_i32,
    bits,
    broadcast8,
    get,
    highest_bit,
    load8,
    lowest_bit,
    permute,
    popcount,
    ptr_at,
    put,
    splat8,
    stack_f32,
    stack_i32,
    store,
    store_compressed,
)
from ..counters import BOX_TESTS, NODES, TRIANGLE_TESTS, count
from .wide_traversal import (
    BLOCK_WORDS,
    BLOCKS,
    LANE,
    LANES,
    LIMIT,
    NO_KEY,
    STACK,
    Query,
    WideHit,
    block_of,
    enter,
    facing,
    fetch,
    filter_ray8,
    group_of,
    hits_of,
    keep_lanes,
    slabs_of,
    sorted_keys,
)

_RAYS = BLOCKS * LANES
_ROOM = STACK + 2 * WIDTH  # entries of a stack; the lowest eight mark its end
_STACKS = _RAYS * _ROOM
_BOUNDS = 2 * WIDTH
_ALL_BOUNDS = _RAYS * _BOUNDS


class _Rays(NamedTuple):
    """The state of up to 64 rays: pointers to scratch memory."""

    keys: I32Ptr  # int32 *, stacks: keys of `sorted_keys`
    links: I32Ptr  # int32 *, stacks: nodes and leaves
    tops: I32Ptr  # int32 *: index of the next entry of each ray's stack
    next: I32Ptr  # int32 *: link of each ray's next node or leaf
    columns: I32Ptr  # int32 *: word of each ray in the rows of its block
    bounds: F32Ptr  # float32 *: `near` and `far` of each ray's tests
    lanes: I32Ptr  # int32 *: bits of hits and, from bit 8 on, of undecided tests


@inlined
def push(nodes, rows, i, is_sorted, rays):
    """Push the children that ray i enters; if they are sorted, with the nearest one on top."""
    at, top = np.int64(get(rays.next, i)) * NODE_WORDS, np.int64(get(rays.tops, i))
    column, links = ptr_at(rows, get(rays.columns, i)), load8(as_i32(nodes), at + LINKS)
    entered, t_near = enter(nodes, at, slabs_of(column, 0), broadcast8(column, LIMIT))
    if is_sorted:
        keys = sorted_keys(entered, t_near)
        store(rays.keys, top, keys)
        store(rays.links, top, permute(links, keys & LANE))
    else:
        store_compressed(rays.links, top, entered, links)
    put(rays.tops, i, top + popcount(bits(entered)))


@inlined
def _test_leaf(tree, rows, i, cull_faces, rays, counters):
    """Test ray i against its leaf. Return whether it may hit a triangle."""
    group, n = wide_leaf(np.int64(get(rays.next, i)))
    count(counters, TRIANGLE_TESTS, n)
    column = ptr_at(rows, get(rays.columns, i))
    tests = filter_hits_branchless(filter_ray8(column, 0), group_of(tree.groups, group * GROUP_WORDS))
    there = (1 << n) - 1
    lanes = (facing(tests.hits, tests.positive, cull_faces) & there) | (tests.unsure & there) << WIDTH
    store(rays.bounds, i * _BOUNDS, tests.near)
    store(rays.bounds, i * _BOUNDS + WIDTH, tests.far)
    put(rays.lanes, i, lanes)
    return lanes != 0


@inlined
def pop(rows, i, is_sorted, rays):
    """Set the next node or leaf of ray i. Return (its link, its index: below the tree's first if there is none)."""
    top = np.int64(get(rays.tops, i)) - 1
    if is_sorted:
        limit = broadcast8(as_i32(rows), get(rays.columns, i) + LIMIT)
        top -= WIDTH - 1
        within = bits((load8(rays.keys, top) & ~LANE) <= limit)
        while within == 0:
            top -= WIDTH
            within = bits((load8(rays.keys, top) & ~LANE) <= limit)
        top += highest_bit(within)
    put(rays.tops, i, top)
    link = np.int64(get(rays.links, top))
    put(rays.next, i, link)
    return link, top


@inlined
def begin_tree(rays, i, bottom):
    """Set ray i to the root of a tree, whose entries begin above eight marks of the end at `bottom`."""
    store(rays.keys, bottom, splat8(NO_KEY))
    put(rays.links, bottom + WIDTH - 1, 0)  # it is prefetched at the end
    put(rays.tops, i, bottom + WIDTH)
    put(rays.next, i, 0)


@inlined
def _start(rays, alive):
    """Set the rays in `alive` (bits) to the root."""
    while alive:
        i = lowest_bit(alive)
        alive &= alive - 1
        begin_tree(rays, i, i * _ROOM)
        put(rays.columns, i, i // LANES * BLOCK_WORDS + i % LANES)


def keep_hits(hits, tree, blocks, i, rays, query, counters):
    """In kernels: store the hits of ray i in its leaf. Return whether this ends the ray's query.

    The type of `hits` selects the implementation. A `WideHit` keeps one hit of each ray, any or the nearest.
    """


@inlined
def leaf_of(rays, i):
    """(first lane of ray i's leaf, bits of its hits and, from bit 8 on, of its undecided tests)."""
    return wide_leaf(np.int64(get(rays.next, i))).group * WIDTH, np.int64(get(rays.lanes, i))


@inlined
def bounds_of(rays, i):
    """`near` and `far` of the tests in ray i's leaf, 8 float32 each."""
    return ptr_at(rays.bounds, i * _BOUNDS)


@inlined
def _keep_one(hits, tree, blocks, i, rays, query):
    j, (first, lanes), bounds = i // LANES, leaf_of(rays, i), bounds_of(rays, i)
    return keep_lanes(tree, block_of(blocks, j), i % LANES, first, lanes, bounds, query.any_hit, hits_of(hits, j))


@overload(keep_hits)
def _keep_hits(hits, tree, blocks, i, rays, query, counters):
    if getattr(hits, "instance_class", None) is WideHit:
        return lambda hits, tree, blocks, i, rays, query, counters: _keep_one(hits, tree, blocks, i, rays, query)
    return None


@inlined
def _walk(tree, blocks, alive, query, rays, hits, counters):
    """`walk_interleaved` for a kind of query that is known when this is compiled."""
    rows, inner, leaves = blocks.rows, alive, np.int64(0)
    while alive:
        count(counters, NODES, popcount(inner))
        count(counters, BOX_TESTS, WIDTH * popcount(inner))
        while inner:
            i = lowest_bit(inner)
            inner &= inner - 1
            push(tree.nodes, rows, i, not query.any_hit, rays)
        possible = np.int64(0)
        while leaves:
            i = lowest_bit(leaves)
            leaves &= leaves - 1
            possible |= np.int64(_test_leaf(tree, rows, i, query.cull_faces, rays, counters)) << i
        while possible:
            i = lowest_bit(possible)
            possible &= possible - 1
            if keep_hits(hits, tree, blocks, i, rays, query, counters):
                alive &= ~(1 << i)
        turn, alive = alive, np.int64(0)
        while turn:
            i = lowest_bit(turn)
            turn &= turn - 1
            link, top = pop(rows, i, not query.any_hit, rays)
            more = top >= i * _ROOM + WIDTH
            fetch(tree, link)
            alive |= np.int64(more) << i
            inner |= np.int64(more and link >= 0) << i
        leaves = alive & ~inner


@inlined
def walk_interleaved(tree, blocks, alive, query, hits, counters):
    """Trace the rays in `alive` (bits) of several prepared blocks and write their hits to `hits`, see `keep_hits`."""
    rays = _Rays(
        stack_i32(_STACKS), stack_i32(_STACKS), stack_i32(_RAYS), stack_i32(_RAYS), stack_i32(_RAYS),
        stack_f32(_ALL_BOUNDS), stack_i32(_RAYS),
    )  # fmt: skip
    _start(rays, alive)
    if query.any_hit:
        _walk(tree, blocks, alive, Query(query.cull_faces, True), rays, hits, counters)
    else:
        _walk(tree, blocks, alive, Query(query.cull_faces, False), rays, hits, counters)
