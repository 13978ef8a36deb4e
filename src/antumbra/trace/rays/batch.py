"""Ray lists: read, check, trace and write sixteen rays at a time. Coherent rays are traced as packets."""

from typing import NamedTuple

import numpy as np

from ...bvh.wide import wide_tree_of
from ...kernels.jit import inlined, kernel
from ...kernels.parallel import CHUNK, STOP, N, new_ticket, run, take, thread_count
from ...kernels.predicate.filters import volumes64
from ...kernels.simd import (
    absolute,
    all_lanes,
    f32_at,
    f64_at,
    get,
    i32_at,
    load16,
    load16x3,
    maximum,
    put,
    splat16,
    stack_f32,
    stack_f64,
    stack_i32,
    stack_i64,
    store,
    to_f32,
    to_f64,
)
from ..counters import N_COUNTERS, RAYS, add_counters, cleared, count, new_counters
from .interleaved import walk_interleaved
from .rayblock import BLOCK_WORDS, DX, LANES, OX, TMAX, TMIN, RayBlock, prepare, ray_of
from .raypacket import is_coherent, walk_packet
from .wide import DEFERRED_WORDS, NONE, Query, WideHit, settle_block, slot_of, start

_BLOCKS = 64  # blocks that a thread takes at a time
_FINITE = np.float32(3.4028235e38)


class Operand(NamedTuple):
    """The memory of an argument, as scalars: see `query.rays.RayList`."""

    address: int
    row: int
    column: int
    double: int  # 1 for float64, 0 for float32 or int32


class Operands(NamedTuple):
    """All arguments of a ray list."""

    origins: Operand
    directions: Operand
    tmin: Operand
    tmax: Operand
    skip: Operand


@inlined
def _operand(rays, k):
    return Operand(rays.layout[k, 0], rays.layout[k, 1], rays.layout[k, 2], rays.layout[k, 3])


@inlined
def _fill_vectors(operand, first, shift, rows, at):
    """`_fill` for rows of three numbers that lie side by side in memory, as arrays of vectors do."""
    begin = operand.address + first * operand.row
    if operand.double:
        columns = load16x3(f64_at(begin), 0)
        for k in range(3):
            x = columns[k]
            store(rows, at + LANES * k, to_f32(x if shift is None else x - shift[k]))
    else:
        columns = load16x3(f32_at(begin), 0)
        for k in range(3):
            x = columns[k]
            store(rows, at + LANES * k, x if shift is None else to_f32(to_f64(x) - shift[k]))


@inlined
def _single(x, shift, k):
    return np.float32(x if shift is None else np.float64(x) - shift[k])


@inlined
def _fill(operand, first, last, columns, shift, rows, at):
    """Write an argument of rays first .. first + 15, minus `shift` and rounded, to rows of a block from word `at`."""
    for i in range(LANES):
        begin = operand.address + min(first + i, last) * operand.row
        if operand.double:
            for k in range(columns):
                put(rows, at + LANES * k + i, _single(get(f64_at(begin + k * operand.column), 0), shift, k))
        else:
            for k in range(columns):
                put(rows, at + LANES * k + i, _single(get(f32_at(begin + k * operand.column), 0), shift, k))


@inlined
def _fill_number(operand, first, last, rows, at):
    """`_fill` of one column, which rays often share."""
    if operand.row != 0:
        _fill(operand, first, last, 1, None, rows, at)
    elif operand.double:
        store(rows, at, splat16(np.float32(get(f64_at(operand.address), 0))))
    else:
        store(rows, at, splat16(get(f32_at(operand.address), 0)))


@inlined
def _fill_points(operand, first, last, shift, rows, at):
    """`_fill` of three columns."""
    side_by_side = operand.column == 4 << operand.double and operand.row == 3 * operand.column
    if side_by_side and first + LANES - 1 <= last:
        _fill_vectors(operand, first, shift, rows, at)
    else:
        _fill(operand, first, last, 3, shift, rows, at)


@inlined
def _load(args, frame, first, last, rows, skip):
    """Convert rays first .. first + 15, and repeat the `last` one beyond the end. Return whether all are legal."""
    f = np.float32
    _fill_points(args.origins, first, last, frame, rows, OX)
    _fill_points(args.directions, first, last, None, rows, DX)
    _fill_number(args.tmin, first, last, rows, TMIN)
    _fill_number(args.tmax, first, last, rows, TMAX)
    if args.skip.row == 0:
        store(skip, 0, splat16(get(i32_at(args.skip.address), 0)))
    else:
        for i in range(LANES):
            put(skip, i, get(i32_at(args.skip.address + min(first + i, last) * args.skip.row), 0))
    tmin, tmax = load16(rows, TMIN), load16(rows, TMAX)
    good = (tmin >= f(0.0)) & (tmin <= _FINITE) & (tmax == tmax)
    for k in range(6):
        good &= absolute(load16(rows, OX + LANES * k)) <= _FINITE  # false for NaN too
    moves = maximum(maximum(absolute(load16(rows, DX)), absolute(load16(rows, DX + LANES))),
                    absolute(load16(rows, DX + 2 * LANES)))  # fmt: skip
    return all_lanes(good & (moves > f(0.0)))


@inlined
def _write_nearest(tree, rays, i, found, out, at):
    """Write the nearest hit of ray i of a block to element `at` of the arrays."""
    slot = slot_of(tree, found, i)
    if slot < 0:
        out.face[at], out.t[at], out.u[at], out.v[at] = -1, np.inf, 0.0, 0.0
        return
    w = volumes64(ray_of(rays, i), tree.corners, slot)
    out.face[at], out.t[at] = get(found.prim, i), get(found.t, i)
    out.u[at], out.v[at] = w.e1 / w.d, w.e2 / w.d


@kernel
def _blocks(ticket, wide, rays, any_hit, out, faults, counters):
    rows, skip = stack_f32(BLOCK_WORDS), stack_i32(LANES)
    found = WideHit(stack_i64(LANES), stack_i64(LANES), stack_f64(LANES), stack_i32(DEFERRED_WORDS))
    block, query = RayBlock(rows, None, skip), Query(rays.cull_faces, any_hit)
    mine, tree = cleared(stack_i64(N_COUNTERS)), wide_tree_of(wide)
    args = Operands(_operand(rays, 0), _operand(rays, 1), _operand(rays, 2), _operand(rays, 3), _operand(rays, 4))
    frame = (rays.frame[0], rays.frame[1], rays.frame[2])
    begin = take(ticket)
    while begin >= 0:
        for b in range(begin, min(begin + ticket[CHUNK], ticket[N])):
            first = b * LANES
            n = min(LANES, rays.n - first)
            count(mine, RAYS, n)
            if not _load(args, frame, first, rays.n - 1, rows, skip):
                faults[0], ticket[STOP] = True, 1
                break
            prepare(rows, tree.reach)
            start(found, block)
            blocked = np.int64(0)
            if is_coherent(rows, tree.reach, any_hit):
                blocked = walk_packet(tree, block, (1 << n) - 1, query, found, mine)
            else:
                walk_interleaved(tree, block, (1 << n) - 1, query, found, mine)
            if get(found.deferred, 0) > 0:
                settle_block(tree, block, query, found, mine)
            for i in range(n):
                if any_hit:
                    out.blocked[first + i] = (blocked >> i) & 1 or get(found.lane, i) != NONE
                else:
                    _write_nearest(tree, block, i, found, out, first + i)
        begin = take(ticket)
    add_counters(counters, mine)


def trace_batch(wide, rays, any_hit, out, threads=None, counters=None, progress=None) -> bool:
    """Trace a `query.rays.RayList` over a `WideBvh` and fill `out`, a `query.rays.HitArrays`.

    Return False, with `out` incomplete, if a ray holds an illegal number: NaN, infinity, a zero direction, ...
    """
    counters = new_counters() if counters is None else counters
    ticket, faults = new_ticket(-(-rays.n // LANES), _BLOCKS), np.zeros(1, np.bool_)
    run(_blocks, thread_count(threads), ticket, wide, rays, any_hit, out, faults, counters, progress=progress)
    return not faults[0]
