"""`packet64`: packets of 64 shadow rays through the wide BVH, culled by their intervals.

The rays of four receivers to their samples, or of 16 receivers to four strata, traverse the tree together: interval
arithmetic tests a node's eight boxes for all 64 rays at once, and only the boxes that it accepts are tested by rays
(`rays.ray_packet`). A pixel's rays start in one point, so a packet of a few receivers is as narrow as the light is
small, however far apart neighbouring pixels are. Shafts of tiles are as wide as the tile at the receivers.
"""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from ...base.progress import ProgressCallback
from ...bvh.nodes import WideBvh, boxes_of, wide_tree_of
from ...kernels.exact.predicate import two_diff
from ...kernels.jit import inlined, kernel
from ...kernels.parallel import items
from ...kernels.simd import (
    absolute,
    bits,
    get,
    load16,
    maximum,
    ptr,
    ptr_at,
    put,
    splat16,
    stack_f32,
    stack_f64,
    stack_i32,
    stack_i64,
    store,
    to_f64,
)
from ...query.shadow_query import ShadowQuery
from ...scene.lights import AMBIENT
from ..counters import N_COUNTERS, add_counters, cleared
from ..light_table import STRATA
from ..rays.ray_packet import walk_packet
from ..rays.wide_traversal import (
    BLOCK_WORDS,
    BLOCKS,
    DEFERRED_WORDS,
    DIRECTION,
    DX,
    ENDS,
    LANES,
    NONE,
    OX,
    PRECISE_WORDS,
    REMAINDER,
    TMAX,
    TMIN,
    Query,
    RayBlock,
    WideHit,
    block_of,
    hits_of,
    prepare,
    rays_in,
    settle_block,
    start,
)
from ..tracer import WIDE, Bits, Box, Counters, Tracer
from ..tracer_cost import Cost, FittedRate
from .packet16 import over_pixels, over_samples
from .ray_tile import (
    SCRATCH_FLOATS,
    SCRATCH_INTS,
    TileRun,
    directions_of,
    finish_tile,
    is_far,
    is_incoherent,
    open_rays,
    origins_of,
    query_chunk_in,
    rows_are_receivers,
    scratch_in,
    settle,
    start_tile,
    trace_tiles,
)

_ROWS, _PRECISE, _RAYS, _TESTS = (BLOCKS * n for n in (BLOCK_WORDS, PRECISE_WORDS, LANES, DEFERRED_WORDS))


@inlined
def _fill_block(tree, rays, r, block):
    """Write the open rays of row r to a block. Return their bits, without empty segments, which nothing blocks."""
    o, d, rows = origins_of(rays, r), directions_of(rays, r), block.rows
    for k in range(3):
        store(rows, OX + LANES * k, o[k])
        store(rows, DX + LANES * k, d[k])
    store(rows, TMIN, splat16(np.float32(0.0)))
    store(rows, TMAX, splat16(np.float32(1.0)))
    own = rays.tile.faces
    store(block.skip, 0, splat16(get(own, r)) if rows_are_receivers(rays) else load16(own, 0))
    prepare(rows, tree.reach)
    return open_rays(rays, r) & bits(maximum(maximum(absolute(d.x), absolute(d.y)), absolute(d.z)) > np.float32(0.0))


@inlined
def _fill_precise(rays, r, block):
    """Write the float64 numbers of row r, which only deferred tests need, to a block."""
    for k in range(3):
        to = to_f64(load16(rays.points, 48 * r + 16 * k))
        direction, remainder = two_diff(to, to_f64(load16(block.rows, OX + LANES * k)))
        store(block.precise, DIRECTION + LANES * k, direction)
        store(block.precise, REMAINDER + LANES * k, remainder)
    for i in range(LANES):
        put(block.precise, ENDS + i, 0.0)
        put(block.precise, ENDS + LANES + i, 1.0)


@kernel
def _trace_rows(tree, rays, first, facing, batch, hits, counters):
    """Trace rows first .. first + 3 of a tile as a packet, and mark blocked rays in `rays.dead`."""
    # In: tree, rays, first, facing. Out: batch, hits, counters, `rays.dead`.
    alive = np.int64(0)
    for j in range(BLOCKS):
        if rays.rows >> (first + j) & 1:
            start(hits_of(hits, j))
            alive |= _fill_block(tree, rays, first + j, block_of(batch, j)) << (j * LANES)
    if alive == 0:
        return
    query = Query(facing, True)
    blocked = walk_packet(tree, batch, alive, query, hits, counters)
    for j in range(BLOCKS):
        mine, block_hits = rays_in(blocked, j), hits_of(hits, j)
        if rays_in(alive, j) == 0:
            continue
        if get(block_hits.deferred, 0) > 0:
            block = block_of(batch, j)
            _fill_precise(rays, first + j, block)
            settle_block(tree, block, query, block_hits, counters)
        mine |= bits(load16(block_hits.lane, 0) != np.int32(NONE)) & rays_in(alive, j)
        put(rays.dead, first + j, get(rays.dead, first + j) | mine)


@kernel
def _trace_packets(ticket, wide, query, samples, job, out, counters):
    """Worker: trace tiles, four rows at a time."""
    scratch, tree = scratch_in(stack_f32(SCRATCH_FLOATS), stack_i32(SCRATCH_INTS)), wide_tree_of(wide)
    batch = RayBlock(stack_f32(_ROWS), stack_f64(_PRECISE), stack_i32(_RAYS), True)
    hits, mine = WideHit(stack_i32(_RAYS), stack_i32(_TESTS)), cleared(stack_i64(N_COUNTERS))
    chunk, places = query_chunk_in(query, samples, job), ptr(out)
    for n in items(ticket):
        rays = start_tile(job, chunk, n, scratch, places, mine)
        for first in range(0, STRATA, BLOCKS):
            if rays.rows >> first & 15:
                _trace_rows(tree, rays, first, chunk.query.facing, batch, hits, mine)
        settle(tree, chunk, rays, scratch, mine)
        finish_tile(chunk, rays, places)
    add_counters(counters, mine)


class IntervalPackets(Tracer):
    """The tracer `packet64`."""

    description = "packets of 64 rays through a tree of eight children per node, culled by the packet's intervals"
    paper = "Boulos et al. 2006, Geometric and arithmetic culling methods for entire ray packets"
    form = WIDE
    by_sample: bool | None = None

    def suits(self, query: ShadowQuery, box: Box) -> bool:
        return not (is_incoherent(query) or is_far(query, box))

    def trace(
        self,
        prepared: WideBvh,
        query: ShadowQuery,
        bits: Bits,
        threads: int | None = None,
        counters: Counters | None = None,
        progress: ProgressCallback | None = None,
        fresh: bool = True,
    ) -> None:
        by_sample = query.samples.shape[1] >= STRATA if self.by_sample is None else self.by_sample
        trace_tiles(TileRun(_trace_packets, by_sample, threads, counters, progress, fresh), prepared, query, bits)
