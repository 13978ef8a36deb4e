"""Samples that lie anywhere, such as interleaved point lights: packets of one receiver's rays through a tree of blocks.

Where the samples of a stratum are as far apart as those of the whole light, its shaft culls nothing, and neither does a
beam. Then multi-frusta tracing falls back to rays: the 16 lanes are a receiver's rays, and at a block each ray in turn
is tested against the triangles, side by side.
"""

import numpy as np

from ..bvh.blocks import ROWS, block_pointers
from ..jit import inlined, kernel
from ..parallel import CHUNK, N, take
from ..scene.lights import LIST
from ..simd import get, lowest_bit, ptr, ptr_at, put
from .aside import ASIDE, put_aside
from .counters import TRIANGLE_TESTS, TRIANGLES, add_counters, count, private_counters
from .descent import left, next_leaf, rays_as_shafts, root, save, saved, slabs_of
from .lighttable import ALL_GROUPS
from .raytest import ray_meets
from .raytile import (
    asked_in,
    directions_of,
    finish_tile,
    new_scratch,
    open_rays,
    origins_of,
    settle,
    start_tile,
    trace_tiles,
)
from .vec import broadcasts, minus

_WIDE = 0.1  # of the light's extents, those of a stratum from which on it is not worth a shaft


def is_scattered(query, table) -> bool:
    """Are the samples of a stratum points of a list, far apart? Those of one light are near each other."""
    if query.light.kind != LIST:
        return False
    lower, upper = table.groups[:, :3].sum(1), table.groups[:, 3:].sum(1)
    whole, strata = upper[:, 1] - lower[:, 1], (upper - lower)[:, ALL_GROUPS // 2 :].mean(1)
    return bool(strata.sum() > _WIDE * whole.sum())


@inlined
def _put_triangles_aside(tree, block, rays, r, lane, unsure, aside):
    """Note the triangles (bits) that may block a ray; the receiver's own one cannot."""
    while unsure != 0:
        slot = np.int64(get(tree.slots, block * 16 + lowest_bit(unsure)))
        unsure &= unsure - 1
        if get(tree.prim_ids, slot) != get(rays.tile.faces, r):
            put_aside(aside, slot, r * rays.row_place + lane * rays.lane_place, 1, np.int64(1))


@kernel
def _leaf(tree, rays, r, code, mask, facing, aside, counters):
    """Test the rays of row r that are in `mask` against a block; bits of those that it blocks."""
    block, present, hits = code >> 5, (np.int64(1) << (code & 31)) - 1, np.int64(0)
    numbers, o = ptr_at(tree.blocks, block * (ROWS * 16)), broadcasts(rays.origins, r * rays.stride, 16)
    while mask != 0:
        lane = lowest_bit(mask)
        mask &= mask - 1
        count(counters, TRIANGLES, code & 31)
        count(counters, TRIANGLE_TESTS, 1)
        hit, unsure = ray_meets(o, minus(broadcasts(rays.points, r * 48 + lane, 16), o), numbers, facing)
        if hit & present != 0:
            hits |= np.int64(1) << lane
        elif unsure & present != 0:
            _put_triangles_aside(tree, block, rays, r, lane, unsure & present, aside)
    return hits


@kernel
def _walk(tree, rays, r, facing, scratch, counters):
    """Trace row r from where it is; whether it must go on when what is put aside has been settled."""
    alive = open_rays(rays, r)
    slabs = slabs_of(rays_as_shafts(origins_of(rays, r), directions_of(rays, r)), alive)
    at = next_leaf(tree, slabs, saved(scratch.at, alive), scratch.stack, alive, counters)
    while at.mask != 0:
        if np.int64(get(scratch.aside, 0)) > ASIDE // 2:
            save(scratch.at, at)
            break
        alive &= ~_leaf(tree, rays, r, ~at.link, at.mask, facing, scratch.aside, counters)
        at = next_leaf(tree, slabs, left(at), scratch.stack, alive, counters)
    put(rays.dead, r, np.int64(get(rays.dead, r)) | (rays.lanes & ~alive))
    return at.mask != 0


@kernel
def _trace_packets(ticket, arrays, query, samples, job, out, counters):
    """Worker: tiles, receiver by receiver."""
    scratch, tree, mine = new_scratch(), block_pointers(arrays), private_counters(counters)
    asked, places, first = asked_in(query, samples, job), ptr(out), take(ticket)
    while first >= 0:
        for n in range(first, min(first + ticket[CHUNK], ticket[N])):
            rays = start_tile(query, samples, job, asked, n, scratch, mine)
            rows = rays.rows
            while rows != 0:
                r = lowest_bit(rows)
                rows &= rows - 1
                save(scratch.at, root(open_rays(rays, r)))
                while _walk(tree, rays, r, asked.facing, scratch, mine):
                    settle(tree, query, asked, rays, scratch, mine)
            settle(tree, query, asked, rays, scratch, mine)
            finish_tile(asked, rays, places)
        first = take(ticket)
    add_counters(counters, mine)


def trace_shadow(tree, query, bits, threads=None, counters=None, progress=None) -> None:
    """Answer a ShadowQuery, as `multifrusta.trace_shadow` does."""
    trace_tiles(_trace_packets, tree, query, True, bits, threads, counters, progress)
