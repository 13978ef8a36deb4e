"""Ray batches: read, check, trace and write 64 rays of a ray list at a time, in four blocks.

Coherent rays are traced as packets (`ray_packet`), others interleaved (`interleaved_rays`). `hit_reports` computes the
t and weights of nearest hits. `all_hits` finds all hits of such batches.
"""

import numpy as np
from numpy.typing import NDArray

from ...bvh.nodes import WideBvh, wide_tree_of
from ...kernels.exact.predicate import two_diff
from ...kernels.jit import inlined, kernel
from ...kernels.marshalling import packed
from ...kernels.parallel import NEXT, STOP, N, items, new_ticket, run, thread_count
from ...kernels.simd import (
    absolute,
    all_lanes,
    as_i32,
    bits,
    broadcast16,
    f32_at,
    f64_at,
    get,
    i32_at,
    load16,
    load16x3,
    maximum,
    ptr,
    ptr_at,
    put,
    select,
    splat16,
    stack_f32,
    stack_f64,
    stack_i32,
    stack_i64,
    store,
    to_f32,
    to_f64,
)
from ...query.ray_list import HitArrays, RayArguments
from ...scene.scene_bounds import NEAREST
from ..counters import N_COUNTERS, RAYS, add_counters, cleared, count, new_counters
from .hit_reports import CORNER_WORDS, REPORT_WORDS, Report, write_nearest
from .interleaved_rays import walk_interleaved
from .ray_packet import LITTLE_TURN, is_coherent_with, walk_packet
from .wide_traversal import (
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
    TMIN,
    Query,
    RayBlock,
    WideHit,
    block_of,
    first_block,
    hits_of,
    prepare,
    rays_of_block,
    settle_block,
    start,
)

_RAYS, _ROWS, _ENDS, _TESTS = (BLOCKS * n for n in (LANES, BLOCK_WORDS, PRECISE_WORDS, DEFERRED_WORDS))  # of all blocks
_LISTED = _RAYS + LANES
_CHUNK = 16  # batches that a thread takes at a time
_FINITE = np.float32(3.4028235e38)
_NEAREST, _ZERO = np.float32(NEAREST), np.float32(0.0)


@inlined
def _fill_vectors(operand, first, shift, rows, at):
    """`_fill` for contiguous rows of three numbers, as in arrays of vectors."""
    begin = operand.address + first * operand.row
    if operand.double:
        columns = load16x3(f64_at(begin), 0)
        for k in range(3):
            store(rows, at + LANES * k, to_f32(columns[k] - shift[k]))
    else:
        columns = load16x3(f32_at(begin), 0)
        for k in range(3):
            store(rows, at + LANES * k, to_f32(to_f64(columns[k]) - shift[k]))


@inlined
def _number(operand, place):
    """The number at an address, in float64."""
    return get(f64_at(place), 0) if operand.double else np.float64(get(f32_at(place), 0))


@inlined
def _fill(operand, first, last, shift, rows, at):
    """Write one argument of rays first .. first + 15, minus `shift` and rounded, to rows of a block from word `at`."""
    for i in range(LANES):
        begin = operand.address + min(first + i, last) * operand.row
        for k in range(3):
            put(rows, at + LANES * k + i, np.float32(_number(operand, begin + k * operand.column) - shift[k]))


@inlined
def _fill_points(operand, first, last, shift, rows, at):
    """`_fill`, faster for contiguous arrays."""
    side_by_side = operand.column == 4 << operand.double and operand.row == 3 * operand.column
    if side_by_side and first + LANES - 1 <= last:
        _fill_vectors(operand, first, shift, rows, at)
    else:
        _fill(operand, first, last, shift, rows, at)


@inlined
def _fill_ends(number, first, last, block, k):
    """Write tmin (k = 0) or tmax (k = 1) of rays first .. first + 15. Return whether all are valid."""
    rows, ends, good = ptr_at(block.rows, TMIN + LANES * k), ptr_at(block.precise, ENDS + LANES * k), True
    for i in range(1 if number.row == 0 else LANES):
        t = number.shared
        if number.address != 0:
            t = _number(number, number.address + min(first + i, last) * number.row)
        put(ends, i, t)
        put(rows, i, np.float32(t))
        good &= t == t and (k == 1 or (t >= 0.0 and t < np.inf))
    if number.row == 0:  # all rays share it
        store(ends, 0, broadcast16(ends, 0))
        store(rows, 0, broadcast16(rows, 0))
    return good


@inlined
def _point_at_targets(block):
    """Replace targets, in the rows of directions, by directions."""
    for k in range(3):
        to, start = to_f64(load16(block.rows, DX + LANES * k)), to_f64(load16(block.rows, OX + LANES * k))
        direction, remainder = two_diff(to, start)
        store(block.precise, DIRECTION + LANES * k, direction)
        store(block.precise, REMAINDER + LANES * k, remainder)
        store(block.rows, DX + LANES * k, to_f32(direction))


@inlined
def _settle(rows, at):
    """`scene.scene_bounds.flush_to_zero` for the points of a block, in three rows from word `at`."""
    for k in range(3):
        x = load16(rows, at + LANES * k)
        store(rows, at + LANES * k, select(absolute(x) < _NEAREST, _ZERO, x))


@inlined
def _load(args, first, last, block):
    """Convert rays first .. first + 15, and repeat the `last` one beyond the end.

    Return (whether all are valid, bits of the rays with a non-zero direction). Only segments may have zero directions.
    """
    f, rows, skip, zero, frame = np.float32, block.rows, block.skip, np.float64(0.0), args.frame
    _fill_points(args.origins, first, last, frame, rows, OX)
    _fill_points(args.directions, first, last, frame if block.segments else (zero, zero, zero), rows, DX)
    _settle(rows, OX)
    if block.segments:
        _settle(rows, DX)
    good = _fill_ends(args.tmin, first, last, block, 0) and _fill_ends(args.tmax, first, last, block, 1)
    if args.skip.address == 0:
        store(skip, 0, splat16(np.int32(args.skip.shared)))
    else:
        for i in range(LANES):
            put(skip, i, get(i32_at(args.skip.address + min(first + i, last) * args.skip.row), 0))
    finite = absolute(load16(rows, OX)) <= _FINITE  # false for NaN too
    for k in range(1, 6):
        finite &= absolute(load16(rows, OX + LANES * k)) <= _FINITE
    if block.segments:
        _point_at_targets(block)
    x, y, z = load16(rows, DX), load16(rows, DX + LANES), load16(rows, DX + 2 * LANES)
    moves = maximum(maximum(absolute(x), absolute(y)), absolute(z)) > f(0.0)
    return good and all_lanes(finite) and (block.segments or all_lanes(moves)), bits(moves)


@inlined
def read_batch(tree, rays, first, batch):
    """Read up to 64 rays of a list, from `first` on, and prepare their blocks.

    Return (number of rays, bits of the rays with a non-zero direction, whether all are valid).
    """
    n = min(_RAYS, rays.n - first)
    alive = -1 if n == _RAYS else (1 << n) - 1
    for j in range((n + LANES - 1) // LANES):
        block = block_of(batch, j)
        good, moving = _load(rays, first + j * LANES, rays.n - 1, block)
        if not good:
            return n, np.int64(0), False
        alive &= moving << (j * LANES) | ~rays_of_block(j)
        prepare(block.rows, tree.reach)
    return n, np.int64(alive), True


@inlined
def _packet_rays(rows, first, candidates, tree_reach, turn, any_hit):
    """Rays (bits) of the blocks in `candidates` that are coherent with block `first`; 0 if its own rays are not."""
    members = 0
    if is_coherent_with(rows, first, first, tree_reach, turn, any_hit):
        while candidates:
            j = first_block(candidates)
            candidates &= ~rays_of_block(j)
            if is_coherent_with(rows, first, j, tree_reach, turn, any_hit):
                members |= rays_of_block(j)
    return members


@inlined
def write_blocked(blocked, n, out, first):
    """Write n answers (bits) from element `first` on, which is a multiple of 4."""
    if n == _RAYS:
        words = as_i32(ptr(out))
        for k in range(_RAYS // 4):  # a product spreads four bits over the bytes of a word
            put(words, first // 4 + k, np.int32(((blocked >> 4 * k) & 15) * 0x204081 & 0x1010101))
    else:
        for i in range(n):
            out[first + i] = (blocked >> i) & 1


@inlined
def trace_blocks(tree, rays, alive, query, turn, hits, counters):
    """Trace the rays in `alive` (bits) of several blocks. Return bits of blocked rays that `hits` does not hold.

    turn : as in `is_coherent_with`
    """
    blocked, single = np.int64(0), np.int64(0)
    while alive:
        j = first_block(alive)
        packet = alive & _packet_rays(rays.rows, j, alive, tree.reach, turn, query.any_hit)
        if packet:
            blocked |= walk_packet(tree, rays, packet, query, hits, counters)
            alive &= ~packet
        else:
            single |= alive & rays_of_block(j)
            alive &= ~rays_of_block(j)
    if single:
        walk_interleaved(tree, rays, single, query, hits, counters)
    return blocked


@kernel
def _blocks(ticket, wide, rays, any_hit, out, faults, counters):
    rows, precise, skip = stack_f32(_ROWS), stack_f64(_ENDS), stack_i32(_RAYS)
    hits = WideHit(stack_i32(_RAYS), stack_i32(_TESTS))
    report = Report(
        stack_f32(CORNER_WORDS), stack_f32(BLOCK_WORDS), stack_f64(REPORT_WORDS), stack_i32(_LISTED), stack_i64(_LISTED)
    )
    batch, query = RayBlock(rows, precise, skip, rays.segments), Query(rays.cull_faces, any_hit)
    mine, tree = cleared(stack_i64(N_COUNTERS)), wide_tree_of(wide)
    for b in items(ticket):
        first = b * _RAYS
        n, alive, good = read_batch(tree, rays, first, batch)
        if not good:
            faults[0], ticket[STOP] = True, 1
            break
        count(mine, RAYS, n)
        n_blocks = (n + LANES - 1) // LANES
        for j in range(n_blocks):
            start(hits_of(hits, j))
        blocked = trace_blocks(tree, batch, alive, query, LITTLE_TURN, hits, mine)
        for j in range(n_blocks):
            block_hits = hits_of(hits, j)
            if get(block_hits.deferred, 0) > 0:
                settle_block(tree, block_of(batch, j), query, block_hits, mine)
            if any_hit:
                blocked |= bits(load16(block_hits.lane, 0) != NONE) << (j * LANES)
        if any_hit:
            write_blocked(blocked, n, out.blocked, first)
        else:
            write_nearest(tree, batch, hits, n, report, out, first)
    add_counters(counters, mine)


class _BatchScratch:
    """Reusable memory that threads write while they trace one list, besides the output arrays."""

    def __init__(self) -> None:
        self.ticket, faults, counters = new_ticket(0, _CHUNK), np.zeros(1, np.bool_), new_counters()
        self.packed = packed(self.ticket), packed(faults), packed(counters)
        self._ticket, self.faults = self.ticket.data, faults.data  # faster for single elements

    def begin(self, blocks: int) -> None:
        ticket = self._ticket
        ticket[NEXT], ticket[STOP], ticket[N], self.faults[0] = 0, 0, blocks, False


class RayTracer:
    """Traces ray lists through a `WideBvh`, which is packed once. Safe to share between Python threads.

    tree : Packed
        The `WideBvh` as an argument of kernels.
    """

    def __init__(self, wide: WideBvh) -> None:
        self.wide, self.tree = wide, packed(wide)
        self._spare: list[_BatchScratch] = []  # pop and append are atomic, so no two calls share an item

    def trace(
        self,
        rays: RayArguments,
        any_hit: bool,
        out: HitArrays,
        threads: int | None = None,
        counters: NDArray[np.int64] | None = None,
    ) -> bool:
        """Trace rays and fill `out`.

        Return False, with `out` incomplete, if a ray is invalid: NaN, infinity, a zero direction, ... Closest-hit
        queries take rays only, not segments.
        """
        scratch = self._spare.pop() if self._spare else _BatchScratch()
        blocks = -(-rays.n // _RAYS)
        scratch.begin(blocks)
        ticket, faults, own_counters = scratch.packed
        sums = own_counters if counters is None else counters
        listed, output = rays.packed(), out.packed()
        if blocks <= _CHUNK:  # no second thread would get any
            _blocks(ticket, self.tree, listed, any_hit, output, faults, sums)
        else:
            n_threads = thread_count(threads)
            run(_blocks, n_threads, scratch.ticket, self.tree, listed, any_hit, output, faults, sums)
        legal = not scratch.faults[0]
        self._spare.append(scratch)
        return legal
