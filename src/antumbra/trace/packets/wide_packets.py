"""`wide`: packets of 64 shadow rays through the wide BVH.

Four rows of a tile's rays traverse the tree together: interval arithmetic tests a node's eight boxes for all 64 rays at
once, and only the boxes that it accepts are tested by rays (`rays.ray_packet`). Incoherent rows advance ray by ray,
interleaved.

Rows are strata of the light, seen from 16 receivers. In `wide:samples`, they are receivers: their rays start in one
point, so that packets are narrow next to the receivers, however far apart neighbouring pixels are.
"""

from typing import Any

import numpy as np

from ...base.progress import ProgressCallback
from ...bvh.nodes import WideBvh, wide_tree_of
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
from ..counters import N_COUNTERS, add_counters, cleared
from ..light_table import STRATA
from ..rays.ray_batches import trace_blocks
from ..rays.ray_packet import COMMON_TURN
from ..rays.single_rays import trace_shadow
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
from ..tracer import WIDE, Bits, Counters, Tracer
from ..tracer_cost import Cost, FittedRate
from .ray_tile import (
    SCRATCH_FLOATS,
    SCRATCH_INTS,
    TileRun,
    directions_of,
    finish_tile,
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
    """Trace rows first .. first + 3 of a tile, and mark blocked rays in `rays.dead`."""
    # In: tree, rays, first, facing. Out: batch, hits, counters, `rays.dead`.
    alive, query = np.int64(0), Query(facing, True)
    for j in range(BLOCKS):
        start(hits_of(hits, j))
        if rays.rows >> (first + j) & 1:
            alive |= _fill_block(tree, rays, first + j, block_of(batch, j)) << (j * LANES)
    blocked = trace_blocks(tree, batch, alive, query, COMMON_TURN, hits, counters)
    for j in range(BLOCKS):
        mine, block_hits, r = rays_in(blocked, j), hits_of(hits, j), first + j
        if get(block_hits.deferred, 0) > 0:
            block = block_of(batch, j)
            _fill_precise(rays, r, block)
            settle_block(tree, block, query, block_hits, counters)
        mine |= bits(load16(block_hits.lane, 0) != np.int32(NONE))
        put(rays.dead, r, get(rays.dead, r) | mine)


@kernel
def _trace_packets(ticket, wide, query, samples, job, out, counters):
    """Worker: trace tiles, four rows at a time."""
    # In: wide, a `WideBvh`; query; samples; job, a `RayTileJob`. Out: out, bits of all receivers
    scratch, tree = scratch_in(stack_f32(SCRATCH_FLOATS), stack_i32(SCRATCH_INTS)), wide_tree_of(wide)
    batch = RayBlock(stack_f32(_ROWS), stack_f64(_PRECISE), stack_i32(_RAYS), True)
    hits, mine = WideHit(stack_i32(_RAYS), stack_i32(_TESTS)), cleared(stack_i64(N_COUNTERS))
    chunk, places = query_chunk_in(query, samples, job), ptr(out)
    for n in items(ticket):
        rays = start_tile(job, chunk, n, scratch, places, mine)
        for first in range(0, STRATA, BLOCKS):
            if rays.rows >> first & ((1 << BLOCKS) - 1):
                _trace_rows(tree, rays, first, chunk.query.facing, batch, hits, mine)
        settle(tree, chunk, rays, scratch, mine)
        finish_tile(chunk, rays, places)
    add_counters(counters, mine)


class WidePackets(Tracer):
    """The tracer `wide`. It also traces a forest of instances, one ray at a time."""

    description = "packets of 64 rays, from 16 receivers to four strata of the light, eight boxes or triangles in SIMD"
    paper = "Boulos et al. 2006, Geometric and arithmetic culling methods for entire ray packets"
    form = WIDE
    cost = Cost(
        rate=FittedRate(
            2.0521, -0.118345, 0.287075, -0.23517, 0.200246, -0.0927732, -0.390668, 0.708013, 0.0640883, 0.0304122,
            -0.0727175, 0.0270047, 0.0256772, 0.00789954, -3.20824e-05, -0.00139981, 0.00913626, -0.137029,
            0.00659514, 0.0279311, -0.0152513, 0.0573332, 0.0, 0.0,
        ),
        form=70.0,
        load=0.03,
        saving=0.25,
        reference=64.6,
    )  # fmt: skip

    by_sample = False  # whether a packet holds the samples of four receivers; otherwise four strata of 16 receivers

    def trace(
        self,
        prepared: Any,
        query: ShadowQuery,
        bits: Bits,
        threads: int | None = None,
        counters: Counters | None = None,
        progress: ProgressCallback | None = None,
        fresh: bool = True,
    ) -> None:
        if isinstance(prepared, WideBvh):
            run = TileRun(_trace_packets, self.by_sample, threads, counters, progress, fresh)
            trace_tiles(run, prepared, query, bits)
        else:
            trace_shadow(prepared, query, bits, threads, counters, progress)


class WideSamplePackets(WidePackets):
    """The tracer `wide:samples`."""

    description = "packets of 64 rays, from four receivers to their samples, eight boxes or triangles in SIMD"
    cost = Cost(
        rate=FittedRate(
            2.5478, 0.510813, 0.348318, -0.274344, 0.104201, -0.0648998, -0.520846, 0.859059, -0.0117851, -0.0344293,
            -0.0506119, -0.028912, 0.0654188, -0.0018483, -0.00714527, -0.00616189, 0.0067254, -0.0321978, -0.01206,
            -0.117583, -0.0138954, -0.0355095, 0.0, 0.0,
        ),
        form=70.0,
        load=0.03,
        saving=0.25,
        reference=35.6,
    )  # fmt: skip

    by_sample = True
