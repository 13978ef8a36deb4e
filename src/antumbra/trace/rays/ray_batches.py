"""Ray batches: read, check, trace and write 64 rays of a ray list at a time, in four blocks.

Coherent rays are traced as packets (`ray_packet`), others interleaved (`interleaved_rays`). `hit_reports` computes the
t and weights of nearest hits. `all_hits` finds all hits of such batches.
"""

from collections.abc import Callable, Iterable
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...bvh.nodes import WideBvh, wide_tree_of
from ...kernels.exact.predicate import two_diff
from ...kernels.jit import inlined, kernel
from ...kernels.marshalling import Packed, packed
from ...kernels.parallel import NEXT, STOP, N, Ticket, items, new_ticket, run, run_short, thread_count
from ...kernels.simd import (
    absolute,
    all_lanes,
    bits,
    broadcast16,
    f32_at,
    f32_bits,
    f64_at,
    gather,
    get,
    i32_at,
    iota16,
    load8x3_pair,
    load16,
    maximum,
    popcount,
    prefetch,
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
    widen_loops,
)
from ...query.ray_list import NO_RAYS, HitArrays, RayArguments, hit_arrays
from ...scene.scene_bounds import NEAREST
from ..counters import N_COUNTERS, RAYS, add_counters, cleared, count, new_counters
from .hit_reports import CORNER_WORDS, REPORT_WORDS, Report, write_nearest
from .interleaved_rays import walk_interleaved
from .packet_extents import LITTLE_TURN, are_coherent, extents_of, is_coherent_with
from .ray_packet import packet_of, walk_packet
from .row_tiles import NO_RUNS, RUN, Runs, line_of, number_at, runs_of
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
_FEW = 512  # batches
_LINE = 16  # float32 of a cache line
_FAR_ROWS = 1 << 16  # bytes between rows, from which on offsets in a tile may exceed int32
_FIRST_COLUMN = np.int64(0x0101010101010101)  # bits of the first ray of each run
_LINES = packed(NO_RUNS).words
_QUERIES = packed(False).words, packed(True).words  # the values of any_hit
_FINITE = np.int32(0x7F7FFFFF)  # the bits of the largest float32
_NEAREST, _ZERO = np.float32(NEAREST), np.float32(0.0)


@inlined
def _fill_vectors(operand, first, step, shift, rows, at):
    """`_fill` for contiguous rows of three numbers, as in arrays of vectors."""
    begin, next_run = operand.address + first * operand.row, 3 * step
    if operand.double:
        columns = load8x3_pair(f64_at(begin), 0, next_run)
        for k in range(3):
            store(rows, at + LANES * k, to_f32(columns[k] - shift[k]))
    else:
        columns = load8x3_pair(f32_at(begin), 0, next_run)
        for k in range(3):
            single = np.float32(shift[k])
            if single == shift[k]:  # float32 rounds the difference in the same way, without conversions
                store(rows, at + LANES * k, columns[k] - single)
            else:
                store(rows, at + LANES * k, to_f32(to_f64(columns[k]) - shift[k]))


@inlined
def _fill_spaced(operand, first, step, shift, rows, at):
    """`_fill` for rows of three float32 at any distance, such as those of origins and directions in one array."""
    begin, lane = f32_at(operand.address + first * operand.row), iota16()
    places = select(lane < RUN, lane, lane + np.int32(step - RUN)) * np.int32(operand.row // 4)
    for k in range(3):
        store(rows, at + LANES * k, to_f32(to_f64(gather(begin, places + np.int32(k))) - shift[k]))


@inlined
def _ray_at(first, step, i, last):
    """Ray i of two runs of eight, of which the second is `step` after the `first`; at most the `last` one."""
    return min(first + (step - RUN) * (i // RUN) + i, last)


@inlined
def _fill(operand, first, step, last, shift, rows, at):
    """Write one argument of two runs of rays, minus `shift` and rounded, to rows of a block from word `at`."""
    for i in range(LANES):
        begin = operand.address + _ray_at(first, step, i, last) * operand.row
        for k in range(3):
            put(rows, at + LANES * k + i, np.float32(number_at(operand, begin + k * operand.column) - shift[k]))


@inlined
def _fill_points(operand, first, step, last, shift, rows, at):
    """`_fill`, faster for numbers side by side."""
    side_by_side = operand.column == 4 << operand.double and first + step + RUN - 1 <= last
    if side_by_side and operand.row == 3 * operand.column:
        _fill_vectors(operand, first, step, shift, rows, at)
    elif side_by_side and not operand.double and operand.row % 4 == 0 and abs(operand.row) < _FAR_ROWS:
        _fill_spaced(operand, first, step, shift, rows, at)
    else:
        _fill(operand, first, step, last, shift, rows, at)


@inlined
def _put_end(block, k, i, t):
    """Write tmin (k = 0) or tmax (k = 1) of ray i. Return whether it is valid."""
    put(block.precise, ENDS + LANES * k + i, t)
    put(block.rows, TMIN + LANES * k + i, np.float32(t))
    return t == t and (k == 1 or (t >= 0.0 and t < np.inf))


@inlined
def _fill_ends(number, first, step, last, block, k):
    """Write tmin (k = 0) or tmax (k = 1) of two runs of rays. Return whether all are valid."""
    good = True
    for i in range(LANES):
        place = number.address + _ray_at(first, step, i, last) * number.row
        good &= _put_end(block, k, i, number_at(number, place))
    return good


@inlined
def _share_end(number, block, k):
    """`_fill_ends` where all rays have the same one."""
    t = number.shared
    if number.address != 0:
        t = number_at(number, number.address)
    good = _put_end(block, k, 0, t)
    rows, ends = ptr_at(block.rows, TMIN + LANES * k), ptr_at(block.precise, ENDS + LANES * k)
    store(ends, 0, broadcast16(ends, 0))
    store(rows, 0, broadcast16(rows, 0))
    return good


@inlined
def share_ends(rays, batch):
    """Write the ends, and the face to skip, that all rays of a list share, to all blocks of a batch.

    Return whether they are valid. `read_batch` keeps them, and writes those that differ from ray to ray.
    """
    good, skip = True, np.int32(-1)
    if rays.skip.address == 0:
        skip = np.int32(rays.skip.shared)
    for j in range(BLOCKS):
        block = block_of(batch, j)
        if rays.tmin.row == 0:
            good &= _share_end(rays.tmin, block, 0)
        if rays.tmax.row == 0:
            good &= _share_end(rays.tmax, block, 1)
        store(block.skip, 0, splat16(skip))
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
def _largest_bits(rows, at):
    """The largest magnitude of a block's points, in three rows from word `at`: its bits, an int32 that orders like it.

    The bits of NaN are the largest.
    """
    x, y, z = load16(rows, at), load16(rows, at + LANES), load16(rows, at + 2 * LANES)
    return maximum(maximum(f32_bits(absolute(x)), f32_bits(absolute(y))), f32_bits(absolute(z)))


@inlined
def _load(args, first, step, last, block):
    """Convert two runs of rays, see `_ray_at`, and repeat the `last` one beyond the end.

    Return (whether all are valid, bits of the rays with a non-zero direction). Only segments may have zero directions.
    """
    rows, skip, zero, frame = block.rows, block.skip, np.float64(0.0), args.frame
    _fill_points(args.origins, first, step, last, frame, rows, OX)
    shift = frame if block.segments else (zero, zero, zero)
    _fill_points(args.directions, first, step, last, shift, rows, DX)
    _settle(rows, OX)
    if block.segments:
        _settle(rows, DX)
    good = True
    if args.tmin.row != 0:
        good = _fill_ends(args.tmin, first, step, last, block, 0)
    if args.tmax.row != 0:
        good &= _fill_ends(args.tmax, first, step, last, block, 1)
    if args.skip.address != 0:
        for i in range(LANES):
            put(skip, i, get(i32_at(args.skip.address + _ray_at(first, step, i, last) * args.skip.row), 0))
    finite = _largest_bits(rows, OX)
    finite = maximum(finite, _largest_bits(rows, DX)) <= _FINITE
    if block.segments:
        _point_at_targets(block)
    moves = _largest_bits(rows, DX) > 0
    return good and all_lanes(finite) and (block.segments or all_lanes(moves)), bits(moves)


@inlined
def read_points(rays, first, rows):
    """Convert the origins of 16 rays of a list from `first` on, and repeat the last one beyond the end."""
    _fill_points(rays.origins, first, np.int64(RUN), rays.n - 1, rays.frame, rows, OX)
    _settle(rows, OX)


@inlined
def read_batch(tree, rays, runs, batch):
    """Read up to 64 rays of a list, those of a `Runs`, and prepare their blocks, after `share_ends`.

    Return (number of rays in the blocks, bits of the rays with a non-zero direction, whether all are valid).
    """
    n, alive = _RAYS, np.int64(-1)
    if runs.step != RUN:
        alive = ((1 << runs.columns) - 1) * _FIRST_COLUMN
    elif rays.n - runs.first < _RAYS:
        n = rays.n - runs.first
        alive = (np.int64(1) << n) - 1
    for j in range((n + LANES - 1) // LANES):
        block = block_of(batch, j)
        good, moving = _load(rays, runs.first + 2 * j * runs.step, runs.step, rays.n - 1, block)
        if not good:
            return n, np.int64(0), False
        alive &= moving << (j * LANES) | ~rays_of_block(j)
        prepare(block.rows, tree.reach)
    return n, alive, True


@inlined
def _packet_rays(rows, first, candidates, tree_reach, turn, any_hit):
    """Rays (bits) of the blocks in `candidates` that are coherent with block `first`; 0 if its own rays are not."""
    members = 0
    if is_coherent_with(rows, first, first, tree_reach, turn, any_hit):
        members = rays_of_block(first)
        candidates &= ~members
        while candidates:
            j = first_block(candidates)
            candidates &= ~rays_of_block(j)
            if is_coherent_with(rows, first, j, tree_reach, turn, any_hit):
                members |= rays_of_block(j)
    return members


@inlined
def write_blocked(blocked, n, runs, out):
    """Write the answers (bits) of a batch with n rays."""
    whole = n == _RAYS and runs.columns == RUN
    for k in range((n + RUN - 1) // RUN):
        row, answers = ptr_at(out, runs.first + k * runs.step), blocked >> k * RUN
        if whole:
            for i in range(RUN):
                put(row, i, (answers >> i) & 1)
        else:
            for i in range(min(runs.columns, n - k * RUN)):
                put(row, i, (answers >> i) & 1)


@inlined
def trace_blocks(tree, rays, alive, query, turn, hits, counters):
    """Trace the rays in `alive` (bits) of several blocks. Return bits of blocked rays that `hits` does not hold.

    turn : as in `is_coherent_with`
    """
    blocked, single, together = np.int64(0), np.int64(0), True  # try all blocks together first
    while alive:
        j = first_block(alive)
        packet = alive
        if not together:
            packet &= _packet_rays(rays.rows, j, alive, tree.reach, turn, query.any_hit)
        if packet:
            extents = extents_of(rays.rows, packet)
            if together and not are_coherent(rays.rows, packet, extents, tree.reach, turn, query.any_hit):
                together = False
                continue
            bounds = packet_of(tree, rays.rows, packet, extents), extents.limit
            blocked |= walk_packet(tree, rays, packet, bounds, query, hits, counters)
            alive &= ~packet
        else:
            single |= alive & rays_of_block(j)
            alive &= ~rays_of_block(j)
    if single:
        walk_interleaved(tree, rays, single, query, hits, counters)
    return blocked


class _Batches(NamedTuple):
    """A list of rays, and its batches."""

    rays: Packed  # a `RayList`
    runs: NDArray[np.int64]  # (b, 3), from `runs_of`


@inlined
def _fetch_next(rays, runs, any_hit, out):
    """Prefetch the memory of the next tile, whose rows are more streams than a processor foresees."""
    for k in range(RUN):
        i = runs.first + k * runs.step + RUN
        for operand in (rays.origins, rays.directions):
            row = f32_at(operand.address + i * operand.row)
            for word in range(0, RUN * operand.row // 4, _LINE):
                prefetch(row, word)
        if not any_hit:
            prefetch(ptr(out.t), i)
            prefetch(ptr(out.face), i)
            prefetch(ptr(out.u), i)
            prefetch(ptr(out.v), i)


@kernel
def _blocks(ticket, wide, batches, any_hit, out, faults, counters):
    widen_loops()
    rays, listed = batches.rays, batches.runs
    rows, precise, skip = stack_f32(_ROWS), stack_f64(_ENDS), stack_i32(_RAYS)
    hits = WideHit(stack_i32(_RAYS), stack_i32(_TESTS))
    report = Report(
        stack_f32(CORNER_WORDS), stack_f32(BLOCK_WORDS), stack_f64(REPORT_WORDS), stack_i32(_LISTED), stack_i64(_LISTED)
    )
    batch, query = RayBlock(rows, precise, skip, rays.segments), Query(rays.cull_faces, any_hit)
    mine, tree, sound = cleared(stack_i64(N_COUNTERS)), wide_tree_of(wide), share_ends(rays, batch)
    for b in items(ticket):
        runs = Runs(listed[b, 0], listed[b, 1], listed[b, 2]) if len(listed) > 0 else line_of(b * _RAYS)
        n, alive, good = read_batch(tree, rays, runs, batch)
        if not (sound and good):
            faults[0], ticket[STOP] = True, 1
            break
        if runs.step != RUN:
            _fetch_next(rays, runs, any_hit, out)
        count(mine, RAYS, popcount(alive))
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
            write_blocked(blocked, n, runs, out.blocked)
        else:
            write_nearest(tree, batch, hits, n, report, out, runs)
    add_counters(counters, mine)


def run_batches(
    worker: Callable[..., object],
    threads: int | None,
    ticket: Ticket,
    *args: Any,
    own: Callable[[], Iterable[Any]] = tuple,
) -> None:
    """`run`; or `run_short` for a few batches, which take milliseconds."""
    (run_short if ticket[N] <= _FEW else run)(worker, thread_count(threads), ticket, *args, own=own)


class _BatchScratch:
    """Reusable memory that threads write while they trace one list, besides the output arrays."""

    def __init__(self) -> None:
        self.ticket, faults, counters = new_ticket(0, _CHUNK), np.zeros(1, np.bool_), new_counters()
        self.arguments = packed(self.ticket), packed(faults), packed(counters)
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
        self._spare = [_BatchScratch()]  # pop and append are atomic, so no two calls share an item
        ticket, faults, counters = self._spare[0].arguments
        others = packed(_Batches(packed(NO_RAYS), NO_RUNS)), packed(False), packed(hit_arrays(0, True))
        self._key = tuple(each.group for each in (ticket, self.tree, *others, faults, counters))

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
        ticket, faults, own_counters = scratch.arguments
        n = rays.n
        if n <= _CHUNK * _RAYS and counters is None:  # no second thread would get any
            scratch.begin(-(-n // _RAYS))
            listed, _arrays = rays.words()  # which live until the kernel returns
            query = listed, _LINES, _QUERIES[any_hit], out.words()
            words = b"".join((ticket.words, self.tree.words, *query, faults.words, own_counters.words))
            _blocks.of_words(self._key, words)  # takes microseconds less than `_blocks(...)`
        else:
            packed_rays = rays.packed()
            runs = runs_of(packed_rays, n)
            scratch.begin(len(runs) or -(-n // _RAYS))
            sums = own_counters if counters is None else counters
            args = self.tree, _Batches(packed_rays, runs), any_hit, out.packed(), faults, sums
            run_batches(_blocks, threads, scratch.ticket, *args)
        return self._end(scratch)

    def run(self, worker: Callable[..., object], threads: int | None, rays: RayArguments, *args: Any) -> bool:
        """Call ``worker(ticket, wide, rays, *args, faults)`` for the batches of rays. Return whether all are valid."""
        scratch, n_batches = self._spare.pop() if self._spare else _BatchScratch(), -(-rays.n // _RAYS)
        ticket, faults, _ = scratch.arguments
        scratch.begin(n_batches)
        arguments = self.tree, rays.packed(), *args, faults
        if n_batches <= _CHUNK:  # no second thread would get any
            worker(ticket, *arguments)
        else:
            run_batches(worker, threads, scratch.ticket, *arguments)
        return self._end(scratch)

    def _end(self, scratch: _BatchScratch) -> bool:
        """Put scratch memory back. Return whether all rays were valid."""
        legal = not scratch.faults[0]
        self._spare.append(scratch)
        return legal
