"""`packet16`: packets of 16 shadow rays, each through the builder's own deep tree.

What multi-frusta tracing is measured against [Benthin and Wald 2009, Sec. 5.1; Wald et al. 2001]: one slab test a node
for all 16 rays, a mask of active rays, and no bounds of packets. A packet is a stratum of 16 neighbouring receivers, or
(`packet16:samples`) a receiver's samples.
Triangles are tested by edge functions, where the paper takes Moeller and Trumbore's test.

The same packets go through a tree of blocks for `scattered` samples.
"""

from functools import partial

import numpy as np
from numba.extending import overload

from ..bvh.blocks import block_pointers
from ..bvh.nodes import EMPTY, Bvh, Tree, tree_of
from ..jit import inlined, kernel
from ..parallel import CHUNK, N, take
from ..simd import bits, get, load16, lowest_bit, ptr, put
from .aside import ASIDE, put_aside
from .counters import CANDIDATES, TRIANGLE_TESTS, TRIANGLES, add_counters, count, private_counters
from .descent import left, next_leaf, rays_as_shafts, root, save, saved, slabs_of
from .raytest import decide, length1, seen_from, triangle_in
from .raytile import (
    asked_in,
    directions_of,
    finish_tile,
    new_scratch,
    open_rays,
    origins_of,
    rows_are_receivers,
    settle,
    start_tile,
    trace_tiles,
)
from .scattered import trace_block


def pointers(prepared):
    """In kernels: the `Tree` of a `Bvh`, the `BlockPointers` of a `BlockTree`."""


def trace_leaf(tree, rays, r, code, mask, facing, aside, counters):
    """In kernels: test the rays of row r in `mask` against a leaf of the tree; bits of those that it blocks."""


@overload(pointers)
def _pointers(prepared):
    if prepared.instance_class is Bvh:
        return lambda prepared: tree_of(prepared)
    return lambda prepared: block_pointers(prepared)


@overload(trace_leaf)
def _trace_leaf(tree, rays, r, code, mask, facing, aside, counters):
    if tree.instance_class is Tree:
        return lambda tree, rays, r, code, mask, facing, aside, counters: _trace_triangles(
            tree, rays, r, code, mask, facing, aside, counters
        )
    return lambda tree, rays, r, code, mask, facing, aside, counters: trace_block(
        tree, rays, r, code, mask, facing, aside, counters
    )


@inlined
def _own(tree, rays, r, slot):
    """Bits of the rays of row r that start on the triangle."""
    if rows_are_receivers(rays):
        return np.int64(0xFFFF) if get(rays.tile.faces, r) == get(tree.prim_ids, slot) else np.int64(0)
    return bits(load16(rays.tile.faces, 0) == get(tree.prim_ids, slot))


@kernel
def _trace_triangles(tree, rays, r, code, mask, facing, aside, counters):
    """`trace_leaf` of a `Tree`, triangle by triangle."""
    hits = np.int64(0)
    if ~code == EMPTY:
        return hits
    o, d = origins_of(rays, r), directions_of(rays, r)
    span, first = length1(d), code >> 3
    for slot in range(first, first + (code & 7) + 1):
        count(counters, TRIANGLES, 1)
        tested = mask & ~hits & ~_own(tree, rays, r, slot)
        if tested == 0:
            continue
        count(counters, CANDIDATES, 1)
        count(counters, TRIANGLE_TESTS, 1)
        hit, unsure = decide(d, seen_from(o, span, triangle_in(tree.corners, slot)), facing)
        unsure &= tested
        if unsure != 0:
            put_aside(aside, slot, r * rays.row_place, rays.lane_place, unsure)
        hits |= hit & tested
        if hits == mask:
            break
    return hits


@kernel
def _walk(tree, rays, r, facing, scratch, counters):
    """Trace row r from where it is; whether it must go on when what is put aside has been settled."""
    alive = open_rays(rays, r)
    slabs = slabs_of(rays_as_shafts(origins_of(rays, r), directions_of(rays, r)), alive)
    at = next_leaf(tree, slabs, saved(scratch.at, alive), scratch.stack, alive, counters)
    while at.mask != 0:
        if np.int64(get(scratch.aside, 0)) > ASIDE:
            save(scratch.at, at)
            break
        alive &= ~trace_leaf(tree, rays, r, ~at.link, at.mask, facing, scratch.aside, counters)
        at = next_leaf(tree, slabs, left(at), scratch.stack, alive, counters)
    put(rays.dead, r, np.int64(get(rays.dead, r)) | (rays.lanes & ~alive))
    return at.mask != 0


@kernel
def _trace_packets(ticket, prepared, query, samples, job, out, counters):
    """Worker: tiles, packet by packet."""
    scratch, tree, mine = new_scratch(), pointers(prepared), private_counters(counters)
    asked, places, first = asked_in(query, samples, job), ptr(out), take(ticket)
    while first >= 0:
        for n in range(first, min(first + ticket[CHUNK], ticket[N])):
            rays = start_tile(query, samples, job, asked, n, scratch, mine)
            left_rows = rays.rows
            while left_rows != 0:
                r = lowest_bit(left_rows)
                left_rows &= left_rows - 1
                save(scratch.at, root(open_rays(rays, r)))
                while _walk(tree, rays, r, asked.facing, scratch, mine):
                    settle(tree, query, asked, rays, scratch, mine)
            settle(tree, query, asked, rays, scratch, mine)
            finish_tile(asked, rays, places)
        first = take(ticket)
    add_counters(counters, mine)


def trace_shadow(by_sample, prepared, query, bits, threads=None, counters=None, progress=None) -> None:
    """Answer a ShadowQuery: set bit s of ``bits[y, x]`` where sample s is occluded.

    by_sample : whether a packet is one receiver's samples, not the samples of 16 receivers
    prepared : Bvh; by sample also BlockTree
    bits : (h, w, ceil(spp / 64)) uint64, zeros on entry
    counters : from `new_counters`, or None
    """
    trace_tiles(_trace_packets, prepared, query, by_sample, bits, threads, counters, progress)


over_pixels = partial(trace_shadow, False)
over_samples = partial(trace_shadow, True)
