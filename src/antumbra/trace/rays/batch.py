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
    maximum,
    put,
    splat16,
    stack_f32,
    stack_f64,
    stack_i32,
    stack_i64,
    store,
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
def _copy(operand, first, last, columns, rows, at):
    """Copy a float32 argument of rays first .. first + 15 to rows of a block from word `at`."""
    if operand.row == 0:
        for k in range(columns):
            store(rows, at + LANES * k, splat16(get(f32_at(operand.address + k * operand.column), 0)))
    elif first + LANES - 1 <= last:
        begin = operand.address + first * operand.row
        for i in range(LANES):
            for k in range(columns):
                put(rows, at + LANES * k + i, get(f32_at(begin + i * operand.row + k * operand.column), 0))
    else:
        for i in range(LANES):
            begin = operand.address + min(first + i, last) * operand.row
            for k in range(columns):
                put(rows, at + LANES * k + i, get(f32_at(begin + k * operand.column), 0))


@inlined
def _move(rows, at, shift):
    """Subtract `shift` from a row in float64, and round. LLVM vectorises this."""
    for i in range(LANES):
        put(rows, at + i, np.float32(np.float64(get(rows, at + i)) - shift))


@inlined
def _fill(operand, first, last, columns, shift, rows, at):
    """Write an argument of rays first .. first + 15, minus `shift` and rounded, to rows of a block from word `at`."""
    if operand.double:
        for i in range(LANES):
            begin = operand.address + min(first + i, last) * operand.row
            for k in range(columns):
                x = get(f64_at(begin + k * operand.column), 0)
                put(rows, at + LANES * k + i, np.float32(x if shift is None else x - shift[k]))
        return
    _copy(operand, first, last, columns, rows, at)
    if shift is not None:
        for k in range(columns):
            _move(rows, at + LANES * k, shift[k])


@inlined
def _load(args, frame, first, last, rows, skip):
    """Convert rays first .. first + 15, and repeat the `last` one beyond the end. Return whether all are legal."""
    f = np.float32
    _fill(args.origins, first, last, 3, frame, rows, OX)
    _fill(args.directions, first, last, 3, None, rows, DX)
    _fill(args.tmin, first, last, 1, None, rows, TMIN)
    _fill(args.tmax, first, last, 1, None, rows, TMAX)
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
