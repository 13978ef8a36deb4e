"""Reports: t and the corners' weights of hits, computed for 16 hits together.

A list of hits names the ray and the triangle of each. LLVM vectorises the double-double arithmetic over 16 of them; the
few whose numbers it cannot round surely are computed again, in exact arithmetic.
"""

from typing import NamedTuple

import numpy as np

from ...bvh.nodes import WIDTH
from ...kernels.exact.filters import (
    UNKNOWN,
    are_differences,
    clamp_weight,
    is_front,
    quick_t,
    quick_weights,
    rounded_t,
    single_weights,
)
from ...kernels.jit import F32Ptr, F64Ptr, I32Ptr, I64Ptr, inlined
from ...kernels.simd import (
    absolute,
    all_lanes,
    bits,
    get,
    load8,
    load16,
    lowest_bit,
    maximum,
    minimum,
    prefetch,
    ptr,
    ptr_at,
    put,
    splat8,
    store,
    to_f32,
    to_f64,
)
from ...kernels.transposition import transposed8
from .row_tiles import RUN, place_of
from .wide_traversal import BLOCK_WORDS, BLOCKS, DX, LANES, NONE, OX, block_of, hits_of, ray_of, slot_of

CORNER_WORDS = 9 * LANES
REPORT_WORDS = 4 * LANES
_UNKNOWN, _INF, _ZERO = np.float32(UNKNOWN), np.float32(np.inf), np.float32(0.0)
_T, _U, _V, _D = 0, LANES, 2 * LANES, 3 * LANES


class Report(NamedTuple):
    """A list of hits, and scratch memory for the numbers of 16 of them: pointers."""

    corners: F32Ptr  # float32 *, CORNER_WORDS: rows of 16, corners of the triangle that each ray hits
    rows: F32Ptr  # float32 *, BLOCK_WORDS: origins and directions, in rows of a block
    numbers: F64Ptr  # float64 *, REPORT_WORDS: rows of 16: t, u, v, d . n; t or u may be UNKNOWN
    rays: I32Ptr  # int32 *: the ray of each hit, and room for LANES more
    slots: I64Ptr  # int64 *: the slot of its triangle, likewise


@inlined
def _vector(rows, at):
    f = np.float64
    return f(get(rows, at)), f(get(rows, at + LANES)), f(get(rows, at + 2 * LANES))


@inlined
def _minus(a, b):
    return a[0] - b[0], a[1] - b[1], a[2] - b[2]


@inlined
def _put_numbers(numbers, i, o, d, triangle):
    """Compute and write the numbers of ray i, from o along d; triangle: its three corners."""
    v0, v1, v2 = triangle
    a, p, q = _minus(v0, o), _minus(v1, v0), _minus(v2, v0)
    (t, det), (u, v) = quick_t(d, a, p, q), quick_weights(d, a, p, q)
    put(numbers, _T + i, t if are_differences(o, v0, v1, v2, a, p, q) else UNKNOWN)
    put(numbers, _U + i, u)
    put(numbers, _V + i, v)
    put(numbers, _D + i, det)


@inlined
def _fill_report(rows, report):
    """Compute the numbers of all sixteen rays. LLVM vectorises the loop."""
    c = report.corners
    for i in range(LANES):
        triangle = _vector(c, i), _vector(c, 3 * LANES + i), _vector(c, 6 * LANES + i)
        _put_numbers(report.numbers, i, _vector(rows, OX + i), _vector(rows, DX + i), triangle)


@inlined
def write_hit(tree, rays, k, report, signed, out, at):
    """Write hit k, whose numbers are in column k mod 16 of the report, to element `at` of the arrays.

    signed : whether its t is written as from `filters.signed_t`
    """
    i, slot, column = np.int64(get(report.rays, k)), get(report.slots, k), k % LANES
    numbers = report.numbers
    t, u, v = get(numbers, _T + column), get(numbers, _U + column), get(numbers, _V + column)
    if rays.segments:  # their directions are not float32
        t, u = UNKNOWN, UNKNOWN
    out.face[at], out.t[at] = get(tree.prim_ids, slot), -t if signed and get(numbers, _D + column) > 0.0 else t
    out.u[at], out.v[at] = clamp_weight(u), clamp_weight(v)
    if t == UNKNOWN:
        ray = ray_of(block_of(rays, i // LANES), i % LANES)
        t = rounded_t(ray, tree.corners, slot)
        out.t[at] = -t if signed and not is_front(ray, tree.corners, slot) else t
    if u == UNKNOWN:
        ray = ray_of(block_of(rays, i // LANES), i % LANES)
        out.u[at], out.v[at] = single_weights(ray, tree.corners, slot)


@inlined
def _all_hit(hits):
    """Whether all rays of a full batch have a hit in a lane."""
    least = load16(hits.lane, 0)
    for j in range(1, BLOCKS):
        least = minimum(least, load16(hits.lane, j * LANES))
    return all_lanes(least >= 0)


@inlined
def _list_hit(tree, report, k, i, slot):
    """Write hit k of a list, that of ray i, and prefetch the corners of its triangle, and its index."""
    put(report.rays, k, i)
    put(report.slots, k, slot)
    corners = ptr_at(tree.corners, 9 * slot)
    prefetch(corners, 0)
    prefetch(corners, 8)
    prefetch(tree.prim_ids, slot)


@inlined
def _list_hits(tree, hits, n, report):
    """List those of n rays that hit, and their slots. Return their number."""
    n_hits = np.int64(0)
    for j in range((n + LANES - 1) // LANES):
        block = hits_of(hits, j)
        there = bits(load16(block.lane, 0) != np.int32(NONE))
        while there:
            i = lowest_bit(there)
            there &= there - 1
            _list_hit(tree, report, n_hits, j * LANES + i, slot_of(tree, block, i))
            n_hits += 1
    return n_hits


@inlined
def _write_misses(n, out, runs):
    """Write a miss for each of n rays; hits are written over it, so that no branch depends on them."""
    if n == BLOCKS * LANES and runs.columns == RUN:
        for first in range(0, n, RUN):
            at = place_of(runs, first)
            store(ptr(out.face), at, splat8(np.int32(-1)))
            store(ptr(out.t), at, to_f64(splat8(_INF)))
            store(ptr(out.u), at, splat8(_ZERO))
            store(ptr(out.v), at, splat8(_ZERO))
    else:
        for i in range(n):
            if i % RUN < runs.columns:
                at = place_of(runs, i)
                out.face[at], out.t[at], out.u[at], out.v[at] = -1, np.inf, 0.0, 0.0


@inlined
def _load_corners(tree, slots, corners):
    """Write the corners of the triangles in sixteen slots to rows of 16."""
    for i in range(LANES):
        put(corners, 8 * LANES + i, get(tree.corners, 9 * get(slots, i) + 8))
    for half in range(0, LANES, WIDTH):
        c, p = tree.corners, ptr_at(slots, half)
        columns = transposed8(
            load8(c, 9 * get(p, 0)), load8(c, 9 * get(p, 1)), load8(c, 9 * get(p, 2)), load8(c, 9 * get(p, 3)),
            load8(c, 9 * get(p, 4)), load8(c, 9 * get(p, 5)), load8(c, 9 * get(p, 6)), load8(c, 9 * get(p, 7)),
        )  # fmt: skip
        for k in range(8):
            store(corners, LANES * k + half, columns[k])


@inlined
def _rows_of(rows, report, first, n_hits, n):
    """Rows of origins and directions of the sixteen hits from the `first` on; rows: of all rays' blocks."""
    if n_hits == n:
        return ptr_at(rows, first // LANES * BLOCK_WORDS)
    for k in range(LANES):
        i = np.int64(get(report.rays, first + k))
        column = i // LANES * BLOCK_WORDS + i % LANES
        for row in range(6):
            put(report.rows, OX + LANES * row + k, get(rows, OX + LANES * row + column))
    return report.rows


@inlined
def pad(report, n_hits):
    """Repeat the last of the hits, so that sixteen can be computed together from any of them on."""
    for k in range(LANES):
        put(report.rays, n_hits + k, get(report.rays, n_hits - 1))
        put(report.slots, n_hits + k, get(report.slots, n_hits - 1))


@inlined
def compute_numbers(tree, rays, report, first, n_hits, n):
    """Compute the numbers of the sixteen hits from the `first` on.

    n : number of rays, if each hits at most once and hits are in the order of rays; otherwise, any other number
    """
    _load_corners(tree, ptr_at(report.slots, first), report.corners)
    _fill_report(_rows_of(rays.rows, report, first, n_hits, n), report)


@inlined
def _clamped(weights):
    """`clamp_weight` of some weights."""
    rounded = to_f32(weights)  # before the limits, which are float32 numbers
    return absolute(minimum(maximum(rounded, np.float32(0.0)), np.float32(1.0)))


@inlined
def _write_numbers(first, report, out, runs):
    """Write t and the weights of the hits of sixteen consecutive rays of a full batch, from ray `first` on.

    Return bits of the hits of which some number is UNKNOWN.
    """
    numbers, unknown = report.numbers, np.int64(0)
    for half in range(0, LANES, RUN):
        at, t, u = place_of(runs, first + half), load8(numbers, _T + half), load8(numbers, _U + half)
        store(ptr(out.t), at, t)
        store(ptr(out.u), at, _clamped(u))
        store(ptr(out.v), at, _clamped(load8(numbers, _V + half)))
        unknown |= bits((to_f32(t) == _UNKNOWN) | (to_f32(u) == _UNKNOWN)) << half
    return unknown


@inlined
def _write_again(tree, rays, unknown, first, report, out, runs):
    """`write_hit` for the hits in `unknown` (bits) of sixteen consecutive rays, from hit `first` on."""
    while unknown:
        k = first + lowest_bit(unknown)
        unknown &= unknown - 1
        write_hit(tree, rays, k, report, False, out, place_of(runs, k))


@inlined
def _write_block(tree, rays, first, report, out, runs):
    """`write_hit` of the listed hits of sixteen consecutive rays of a full batch, from ray `first` on."""
    compute_numbers(tree, rays, report, first, BLOCKS * LANES, BLOCKS * LANES)
    unknown = _write_numbers(first, report, out, runs)
    for half in range(0, LANES, RUN):
        faces, slots = ptr_at(out.face, place_of(runs, first + half)), ptr_at(report.slots, first + half)
        for k in range(RUN):
            put(faces, k, get(tree.prim_ids, get(slots, k)))
    _write_again(tree, rays, unknown, first, report, out, runs)


@inlined
def _is_fan(rows, lanes, o, lane):
    """Whether sixteen rays come from the point o and hit the triangle in a lane; lanes: of their `WideHit`."""
    same = load16(lanes, 0) == np.int32(lane)
    for k in range(3):
        same &= load16(rows, OX + LANES * k) == o[k]
    return all_lanes(same)


@inlined
def _fan_end(rows, hits, j):
    """The end of the fan of blocks that begins with block j of a full batch; j if there is none.

    The rays of a fan come from one point, and hit the same triangle.
    """
    first, lane = ptr_at(rows, j * BLOCK_WORDS), get(hits.lane, j * LANES)
    o = get(first, OX), get(first, OX + LANES), get(first, OX + 2 * LANES)
    end = j
    while end < BLOCKS and _is_fan(ptr_at(rows, end * BLOCK_WORDS), ptr_at(hits.lane, end * LANES), o, lane):
        end += 1
    return end


@inlined
def _write_fan(tree, rays, blocks, report, out, runs):
    """`write_hit` of the rays of a fan, those of `blocks` (first, end). LLVM computes once what they have in common."""
    f, slot = np.float64, get(report.slots, blocks[0] * LANES)
    c, k, o = tree.corners, 9 * slot, _vector(rays.rows, blocks[0] * BLOCK_WORDS + OX)
    v0 = f(get(c, k)), f(get(c, k + 1)), f(get(c, k + 2))
    v1 = f(get(c, k + 3)), f(get(c, k + 4)), f(get(c, k + 5))
    v2 = f(get(c, k + 6)), f(get(c, k + 7)), f(get(c, k + 8))
    faces = splat8(np.int32(get(tree.prim_ids, slot)))
    for j in range(blocks[0], blocks[1]):
        rows, first = ptr_at(rays.rows, j * BLOCK_WORDS), j * LANES
        for i in range(LANES):
            _put_numbers(report.numbers, i, o, _vector(rows, DX + i), (v0, v1, v2))
        unknown = _write_numbers(first, report, out, runs)
        store(ptr(out.face), place_of(runs, first), faces)
        store(ptr(out.face), place_of(runs, first + RUN), faces)
        if unknown:
            for i in range(LANES):
                put(report.rays, first + i, first + i)
                put(report.slots, first + i, slot)
            _write_again(tree, rays, unknown, first, report, out, runs)


@inlined
def _write_all(tree, rays, hits, report, out, runs):
    """`write_nearest` for a full batch whose rays all hit."""
    fans, j = np.int64(0), np.int64(0)  # fans: the ends of the blocks' fans, four bits each
    while j < BLOCKS:
        end, first = _fan_end(rays.rows, hits, j), j * LANES
        for i in range(first, first + (1 if end > j else LANES)):
            _list_hit(tree, report, i, i, np.int64(get(tree.slots, get(hits.lane, i))))
        fans |= end << 4 * j
        j = max(end, j + 1)
    j = np.int64(0)
    while j < BLOCKS:
        end = (fans >> 4 * j) & 15
        if end > j:
            _write_fan(tree, rays, (j, end), report, out, runs)
        else:
            _write_block(tree, rays, j * LANES, report, out, runs)
        j = max(end, j + 1)


@inlined
def write_nearest(tree, rays, hits, n, report, out, runs):
    """Write the nearest hits of n rays of several blocks, the batch `runs` of the list that the arrays are for."""
    if n == BLOCKS * LANES and runs.columns == RUN and _all_hit(hits):
        _write_all(tree, rays, hits, report, out, runs)
        return
    n_hits = _list_hits(tree, hits, n, report)
    _write_misses(n, out, runs)  # while the corners are fetched
    if n_hits == 0:
        return
    pad(report, n_hits)
    for begin in range(0, n_hits, LANES):
        compute_numbers(tree, rays, report, begin, n_hits, n)
        for k in range(begin, min(begin + LANES, n_hits)):
            write_hit(tree, rays, k, report, False, out, place_of(runs, np.int64(get(report.rays, k))))
