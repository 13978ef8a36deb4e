"""`wide`: packets of 64 shadow rays through the wide BVH.

Four rows of a tile's rays traverse the tree together: interval arithmetic tests a node's eight boxes for all 64 rays at
once, and only the boxes that it accepts are tested by rays (`rays.ray_packet`). Incoherent rows advance ray by ray,
interleaved.

Rows are strata of the light, seen from 16 receivers; with fewer than four samples, those of four neighbouring tiles. In
`wide:samples`, they are receivers: their rays start in one point, so that packets are narrow next to the receivers,
however far apart neighbouring pixels are.
"""

from typing import Any, NamedTuple

import numpy as np

from ...base.progress import ProgressCallback
from ...bvh.nodes import WideBvh, wide_tree_of
from ...kernels.exact.predicate import two_diff
from ...kernels.jit import F32Ptr, I32Ptr, inlined, kernel
from ...kernels.parallel import shares
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
from ..counters import N_COUNTERS, add_counters, cleared
from ..light_table import STRATA
from ..rays.packet_extents import COMMON_TURN
from ..rays.ray_batches import trace_blocks
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
    rays_by_stratum,
    read_tile,
    rows_are_receivers,
    scratch_in,
    settle,
    start_tile,
    trace_tiles,
)

_ROWS, _PRECISE, _RAYS, _TESTS = (BLOCKS * n for n in (BLOCK_WORDS, PRECISE_WORDS, LANES, DEFERRED_WORDS))
_FLOATS, _INTS = BLOCKS * SCRATCH_FLOATS, BLOCKS * SCRATCH_INTS


class _Memory(NamedTuple):
    """A thread's memory for a packet and its tiles, at most four."""

    floats: F32Ptr  # float32 *, SCRATCH_FLOATS per tile
    ints: I32Ptr  # int32 *, SCRATCH_INTS per tile
    batch: RayBlock  # four blocks
    hits: WideHit  # of these
    query: Query  # of all packets


@inlined
def _scratch_of(memory, j):
    """`RayTileScratch` of tile j."""
    return scratch_in(ptr_at(memory.floats, j * SCRATCH_FLOATS), ptr_at(memory.ints, j * SCRATCH_INTS))


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
def _read_row(tree, rays, r, memory, j):
    """Read row r of a tile as block j of a packet. Return bits of its rays among those of the packet."""
    # In: tree, rays, r, j. Out: memory
    start(hits_of(memory.hits, j))
    if (rays.rows >> r) & 1 == 0:
        return np.int64(0)
    return np.int64(_fill_block(tree, rays, r, block_of(memory.batch, j))) << (j * LANES)


@kernel
def _trace_packet(tree, alive, memory, counters):
    """Trace the rays of a `tree` in `alive` (bits). Return bits of blocked rays that `memory.hits` does not hold."""
    return trace_blocks(tree, memory.batch, alive, memory.query, COMMON_TURN, memory.hits, counters)


@kernel
def _finish_row(tree, rays, r, memory, j, blocked, counters):
    """Settle the deferred tests of row r of a tile, block j of a packet, and mark its blocked rays in `rays.dead`."""
    # In: tree; memory; blocked, from `_trace_packet`
    mine, hits = rays_in(blocked, j), hits_of(memory.hits, j)
    if get(hits.deferred, 0) > 0:
        block = block_of(memory.batch, j)
        _fill_precise(rays, r, block)
        settle_block(tree, block, memory.query, hits, counters)
    mine |= bits(load16(hits.lane, 0) != np.int32(NONE))
    put(rays.dead, r, get(rays.dead, r) | mine)


@kernel
def _trace_tile(tree, job, chunk, n, memory, places, counters):
    """Trace tile n, four rows at a time."""
    # In: tree; job; chunk; n. Scratch: memory. Out: places, pointer to the bits of all receivers; counters
    scratch = _scratch_of(memory, 0)
    rays = start_tile(job, chunk, n, scratch, places, counters)
    for first in range(0, STRATA, BLOCKS):
        if rays.rows >> first & ((1 << BLOCKS) - 1) == 0:
            continue
        alive = np.int64(0)
        for j in range(BLOCKS):
            alive |= _read_row(tree, rays, first + j, memory, j)
        blocked = _trace_packet(tree, alive, memory, counters)
        for j in range(BLOCKS):
            _finish_row(tree, rays, first + j, memory, j, blocked, counters)
    settle(tree, chunk, rays, scratch, counters)
    finish_tile(chunk, rays, places)


@kernel
def _trace_tiles(tree, job, chunk, tiles, memory, places, counters):
    """Trace n <= 4 tiles together, from tile `first` on: a packet holds one stratum of each."""
    # In: tiles, (first, n); tree, job, chunk, memory and places as for `_trace_tile`
    (first, n), lanes = tiles, stack_i64(BLOCKS)
    for j in range(n):
        put(lanes, j, read_tile(job, chunk, first + j, _scratch_of(memory, j), places, counters))
    for r in range(chunk.n_samples):
        alive = np.int64(0)
        for j in range(n):
            rays = rays_by_stratum(chunk, _scratch_of(memory, j), get(lanes, j))
            alive |= _read_row(tree, rays, r, memory, j)
        blocked = _trace_packet(tree, alive, memory, counters)
        for j in range(n):
            rays = rays_by_stratum(chunk, _scratch_of(memory, j), get(lanes, j))
            _finish_row(tree, rays, r, memory, j, blocked, counters)
    for j in range(n):
        scratch = _scratch_of(memory, j)
        rays = rays_by_stratum(chunk, scratch, get(lanes, j))
        settle(tree, chunk, rays, scratch, counters)
        finish_tile(chunk, rays, places)


@kernel
def _trace_packets(ticket, wide, query, samples, job, out, counters):
    """Worker: trace tiles, one by one or, where they have too few samples for a packet, four together."""
    # In: wide, a `WideBvh`; query; samples; job, a `RayTileJob`. Out: out, bits of all receivers
    batch = RayBlock(stack_f32(_ROWS), stack_f64(_PRECISE), stack_i32(_RAYS), True)
    hits, mine = WideHit(stack_i32(_RAYS), stack_i32(_TESTS)), cleared(stack_i64(N_COUNTERS))
    tree, chunk, places = wide_tree_of(wide), query_chunk_in(query, samples, job), ptr(out)
    memory = _Memory(stack_f32(_FLOATS), stack_i32(_INTS), batch, hits, Query(chunk.query.facing, True))
    together = BLOCKS if job.n_samples < BLOCKS and not job.by_sample else 1
    for begin, end in shares(ticket):
        for n in range(begin, end, together):
            if together == 1:
                _trace_tile(tree, job, chunk, n, memory, places, mine)
            else:
                _trace_tiles(tree, job, chunk, (n, min(together, end - n)), memory, places, mine)
    add_counters(counters, mine)


class WidePackets(Tracer):
    """The tracer `wide`. It also traces a forest of instances, one ray at a time."""

    description = "packets of 64 rays, from 16 receivers to four strata or 64 to one, eight boxes or triangles in SIMD"
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
