"""Ray lists: read, check, trace and write 64 rays at a time, in four blocks. Coherent rays are traced as packets."""

from typing import NamedTuple

import numpy as np

from ...bvh.nodes import wide_tree_of
from ...kernels.exact.filters import UNKNOWN, are_differences, quick_t, quick_weights, rounded_t, share, single_weights
from ...kernels.exact.predicate import two_diff
from ...kernels.jit import F32Ptr, F64Ptr, inlined, kernel
from ...kernels.marshalling import packed
from ...kernels.parallel import STOP, items, new_ticket, run, thread_count
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
from .ray_packet import runs_along, walk_packet
from .single_rays import walk_interleaved
from .wide_traversal import (
    BLOCK_WORDS,
    BLOCKS,
    DEFERRED_WORDS,
    DX,
    ENDS,
    LANES,
    NONE,
    OX,
    PRECISE_WORDS,
    REST,
    TMIN,
    WAY,
    Query,
    RayBlock,
    WideHit,
    block_of,
    first_block,
    hits_of,
    prepare,
    ray_of,
    rays_in,
    rays_of_block,
    settle_block,
    slot_of,
    start,
)

# --- What sixteen rays report of their nearest hits: t and weights. LLVM computes them side by side -------------------


CORNER_WORDS = 9 * LANES
REPORT_WORDS = 3 * LANES
_T, _U, _V = 0, LANES, 2 * LANES


class Report(NamedTuple):
    """Pointers to scratch memory."""

    corners: F32Ptr  # float32 *, CORNER_WORDS: rows of 16, the corners of the triangle that each ray meets
    numbers: F64Ptr  # float64 *, REPORT_WORDS: rows of 16: t, u, v, or UNKNOWN for t or u


@inlined
def _vector(rows, at):
    f = np.float64
    return f(get(rows, at)), f(get(rows, at + LANES)), f(get(rows, at + 2 * LANES))


@inlined
def _minus(a, b):
    return a[0] - b[0], a[1] - b[1], a[2] - b[2]


@inlined
def _fill_report(rows, report):
    """Compute the numbers of all sixteen rays. LLVM vectorises this."""
    corners, out = report.corners, report.numbers
    for i in range(LANES):
        o, d = _vector(rows, OX + i), _vector(rows, DX + i)
        v0, v1, v2 = _vector(corners, i), _vector(corners, 3 * LANES + i), _vector(corners, 6 * LANES + i)
        a, p, q = _minus(v0, o), _minus(v1, v0), _minus(v2, v0)
        t, (u, v) = quick_t(d, a, p, q), quick_weights(d, a, p, q)
        put(out, _T + i, t if are_differences(o, v0, v1, v2, a, p, q) else UNKNOWN)
        put(out, _U + i, u)
        put(out, _V + i, v)


@inlined
def _write(tree, rays, found, i, report, out, at):
    """Write the nearest hit of ray i of a block to element `at` of the arrays."""
    slot, numbers = slot_of(tree, found, i), report.numbers
    if slot < 0:
        out.face[at], out.t[at], out.u[at], out.v[at] = -1, np.inf, 0.0, 0.0
        return
    t, u, v = get(numbers, _T + i), share(get(numbers, _U + i)), share(get(numbers, _V + i))
    if t == UNKNOWN:
        t = rounded_t(ray_of(rays, i), tree.corners, slot)
    if get(numbers, _U + i) == UNKNOWN:
        u, v = single_weights(ray_of(rays, i), tree.corners, slot)
    out.face[at], out.t[at], out.u[at], out.v[at] = get(found.prim, i), t, u, v


@inlined
def write_nearest(tree, rays, found, n, report, out, first):
    """Write the nearest hits of the first n rays of a block from element `first` of the arrays on."""
    for i in range(n):
        slot = slot_of(tree, found, i)
        at = 9 * (slot if slot >= 0 else np.int64(0))
        for k in range(9):
            put(report.corners, LANES * k + i, get(tree.corners, at + k))
    _fill_report(rays.rows, report)
    for i in range(n):
        _write(tree, rays, found, i, report, out, first + i)


# ---------------------------------------------------------------------------------------------------------------------
# Ray lists: read, check, trace and write 64 rays at a time, in four blocks. Coherent rays are traced as packets.


_RAYS, _ROWS, _ENDS, _TESTS = (BLOCKS * n for n in (LANES, BLOCK_WORDS, PRECISE_WORDS, DEFERRED_WORDS))  # of all blocks
_CHUNK = 16  # times as many blocks, which a thread takes at a time
_FINITE = np.float32(3.4028235e38)
_NEAREST, _ZERO = np.float32(NEAREST), np.float32(0.0)


@inlined
def _fill_vectors(operand, first, shift, rows, at):
    """`_fill` for rows of three numbers that lie side by side in memory, as arrays of vectors do."""
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
    """Write an argument of rays first .. first + 15, minus `shift` and rounded, to rows of a block from word `at`."""
    for i in range(LANES):
        begin = operand.address + min(first + i, last) * operand.row
        for k in range(3):
            put(rows, at + LANES * k + i, np.float32(_number(operand, begin + k * operand.column) - shift[k]))


@inlined
def _fill_points(operand, first, last, shift, rows, at):
    """`_fill`, faster where memory allows."""
    side_by_side = operand.column == 4 << operand.double and operand.row == 3 * operand.column
    if side_by_side and first + LANES - 1 <= last:
        _fill_vectors(operand, first, shift, rows, at)
    else:
        _fill(operand, first, last, shift, rows, at)


@inlined
def _fill_ends(number, first, last, block, k):
    """Write tmin (k = 0) or tmax (k = 1) of rays first .. first + 15. Return whether all are legal."""
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
    """Make directions of the targets in the rows of directions."""
    for k in range(3):
        to, start = to_f64(load16(block.rows, DX + LANES * k)), to_f64(load16(block.rows, OX + LANES * k))
        way, rest = two_diff(to, start)
        store(block.precise, WAY + LANES * k, way)
        store(block.precise, REST + LANES * k, rest)
        store(block.rows, DX + LANES * k, to_f32(way))


@inlined
def _settle(rows, at):
    """`scene.scene_bounds.flush_to_zero` for the points of a block, in three rows from word `at`."""
    for k in range(3):
        x = load16(rows, at + LANES * k)
        store(rows, at + LANES * k, select(absolute(x) < _NEAREST, _ZERO, x))


@inlined
def _load(args, first, last, block):
    """Convert rays first .. first + 15, and repeat the `last` one beyond the end.

    Return (whether all are legal, bits of the rays that go anywhere). A ray needs a direction, a segment does not.
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
    moves = maximum(maximum(absolute(load16(rows, DX)), absolute(load16(rows, DX + LANES))),
                    absolute(load16(rows, DX + 2 * LANES))) > f(0.0)  # fmt: skip
    return good and all_lanes(finite) and (block.segments or all_lanes(moves)), bits(moves)


@inlined
def _together(rows, first, left, tree_reach, any_hit):
    """Rays (bits) of the blocks of `left` that run along block `first`; 0 if not even its own rays do."""
    found = np.int64(0)
    if runs_along(rows, first, first, tree_reach, any_hit):
        while left:
            j = first_block(left)
            left &= ~rays_of_block(j)
            if runs_along(rows, first, j, tree_reach, any_hit):
                found |= rays_of_block(j)
    return found


@inlined
def _write_blocked(blocked, n, out, first):
    """Write n answers (bits) from element `first` on, a multiple of 4."""
    if n == _RAYS:
        words = as_i32(ptr(out))
        for k in range(_RAYS // 4):  # a product spreads four bits over the bytes of a word
            put(words, first // 4 + k, np.int32(((blocked >> 4 * k) & 15) * 0x204081 & 0x1010101))
    else:
        for i in range(n):
            out[first + i] = (blocked >> i) & 1


@inlined
def _trace(tree, rays, alive, query, found, counters):
    """Trace the rays in `alive` (bits) of several blocks; return bits of blocked rays that `found` does not tell."""
    blocked = np.int64(0)
    while alive:
        j = first_block(alive)
        packet = alive & _together(rays.rows, j, alive, tree.reach, query.any_hit)
        if packet:
            blocked |= walk_packet(tree, rays, packet, query, found, counters)
            alive &= ~packet
        else:
            walk_interleaved(tree, block_of(rays, j), rays_in(alive, j), query, hits_of(found, j), counters)
            alive &= ~rays_of_block(j)
    return blocked


@kernel
def _blocks(ticket, wide, rays, any_hit, out, faults, counters):
    rows, precise, skip = stack_f32(_ROWS), stack_f64(_ENDS), stack_i32(_RAYS)
    found = WideHit(stack_i32(_RAYS), stack_i64(_RAYS), stack_f64(_RAYS), stack_i32(_TESTS))
    report = Report(stack_f32(CORNER_WORDS), stack_f64(REPORT_WORDS))
    block, query = RayBlock(rows, precise, skip, rays.segments), Query(rays.cull_faces, any_hit)
    mine, tree = cleared(stack_i64(N_COUNTERS)), wide_tree_of(wide)
    for b in items(ticket):
        first = b * _RAYS
        n = min(_RAYS, rays.n - first)
        count(mine, RAYS, n)
        n_blocks = (n + LANES - 1) // LANES
        alive = np.int64(-1) if n == _RAYS else (np.int64(1) << n) - 1
        for j in range(n_blocks):
            own = block_of(block, j)
            good, moving = _load(rays, first + j * LANES, rays.n - 1, own)
            if not good:
                faults[0], ticket[STOP] = True, 1
                break
            alive &= moving << (j * LANES) | ~rays_of_block(j)
            prepare(own.rows, tree.reach)
            start(hits_of(found, j), own)
        if faults[0]:
            break
        blocked = _trace(tree, block, alive, query, found, mine)
        for j in range(n_blocks):
            hits = hits_of(found, j)
            if get(hits.deferred, 0) > 0:
                settle_block(tree, block_of(block, j), query, hits, mine)
            blocked |= bits(load16(hits.lane, 0) != NONE) << (j * LANES)
        if any_hit:
            _write_blocked(blocked, n, out.blocked, first)
        else:
            for j in range(n_blocks):
                at, left = j * LANES, min(LANES, n - j * LANES)
                write_nearest(tree, block_of(block, j), hits_of(found, j), left, report, out, first + at)
    add_counters(counters, mine)


class _BatchScratch:
    """What threads write while they trace one list, besides its answers: made once, and used again."""

    def __init__(self) -> None:
        self.ticket, self.faults, self.counters = new_ticket(0, _CHUNK), np.zeros(1, np.bool_), new_counters()
        self.packed = packed(self.ticket), (packed(self.faults), packed(self.counters))

    def begin(self, blocks: int) -> None:
        self.ticket[:3], self.faults[0] = (0, 0, blocks), False


class RayTracer:
    """Traces ray lists through a `WideBvh`, which is packed once. Threads of Python may share it."""

    def __init__(self, wide):
        self.wide, self._tree = wide, packed(wide)
        self._spare: list[_BatchScratch] = []  # no two calls have the same: a list hands out items atomically

    def trace(self, rays: RayArguments, any_hit: bool, out: HitArrays, threads=None, counters=None) -> bool:
        """Trace rays and fill `out`.

        Return False, with `out` incomplete, if a ray holds an illegal number: NaN, infinity, a zero direction, ... The
        nearest hit is for rays only, not for segments.
        """
        scratch = self._spare.pop() if self._spare else _BatchScratch()
        blocks = -(-rays.n // _RAYS)
        scratch.begin(blocks)
        ticket, (faults, own) = scratch.packed
        rest = self._tree, rays.packed(), any_hit, out.packed(), faults, own if counters is None else counters
        if blocks <= _CHUNK:  # no second thread would get any
            _blocks(ticket, *rest)
        else:
            run(_blocks, thread_count(threads), scratch.ticket, *rest)
        legal = not scratch.faults[0]
        self._spare.append(scratch)
        return legal
