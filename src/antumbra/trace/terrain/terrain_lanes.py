"""Shadow rays from the vertices of terrain towards distant lights, 16 neighbours of a row at a time.

All rays towards one light cross the edges of the grid at the offsets of a stencil (`terrain_stencils`), so 16
neighbours read 16 consecutive heights. A ray above all edges by more than the tolerance is not blocked. A ray that
starts above the surface and is below an edge by more than the tolerance is blocked: it has met the surface on its way.
The few rays between the two are traced by `terrain_rays`, so the bits are those of every other tracer.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...base.progress import ProgressCallback
from ...kernels.exact.predicate import segment
from ...kernels.jit import F32Ptr, F64Ptr, I32Ptr, I64Ptr, U8Ptr, inlined, kernel
from ...kernels.parallel import items, new_ticket, run
from ...kernels.simd import (
    bits,
    fma,
    get,
    load16,
    lowest_bit,
    mask_from_bits16,
    popcount,
    ptr,
    put,
    reduce_min,
    select,
    splat16,
    stack_f32,
    stack_i64,
)
from ...kernels.vec3 import get3
from ...query.receivers import FREE, NOTHING
from ...query.shadow_query import ShadowQuery, horizon_of, is_above, patch_of, query_pointers, sample_of, set_bit
from .terrain_rays import (
    BLOCKERS,
    RECEIVERS,
    TerrainTree,
    forget_blockers,
    is_blocked,
    shadow_receiver,
    starts_above,
    terrain_pointers,
)
from .terrain_stencils import BLOCKS, COLUMN_PAD, LANES, NO_SURFACE, ROW_PAD, Relief, Stencils

_FAR = np.float32(1e30)
_FINE, _COARSE = BLOCKS
_FINE_SHIFT, _COARSE_SHIFT = _FINE.bit_length() - 1, _COARSE.bit_length() - 1
_STEPS = 4  # between looks at the heights ahead


class _ReliefPointers(NamedTuple):
    """Pointers to a `Relief`, free of reference counts."""

    high: F32Ptr
    low: F32Ptr
    tops: F32Ptr
    starts: I64Ptr
    widths: I64Ptr
    whole: int
    stride: int
    rows: int  # of the grid
    columns: int
    highest: np.float32
    holes: U8Ptr
    row_pad: int  # around the grid
    column_pad: int
    row_border: int  # rows without data along each side of the grid
    column_border: int


class _StencilPointers(NamedTuple):
    """Pointers to `Stencils`."""

    steps: I64Ptr
    quadrant: I64Ptr
    per_step: F64Ptr
    place: I32Ptr
    rise: F32Ptr
    first: I64Ptr
    ends: I32Ptr
    weights: F32Ptr
    above: F32Ptr
    below: F32Ptr


class _Run(NamedTuple):
    """Receivers at neighbouring vertices of a row, one per lane."""

    first: int  # receiver of lane 0
    row: int
    column: int
    at: int  # offset of lane 0 in the arrays of a `Relief`
    lanes: int  # bits


@inlined
def _relief_pointers(relief, tree):
    inside = np.int64(relief.bordered)
    return _ReliefPointers(
        ptr(relief.high), ptr(relief.low), ptr(relief.tops), ptr(relief.starts), ptr(relief.widths),
        np.int64(relief.whole), np.int64(relief.high.shape[1]), np.int64(len(tree.y)), np.int64(len(tree.x)),
        np.float32(tree.highest), ptr(relief.holes),
        (1 - inside) * ROW_PAD, (1 - inside) * COLUMN_PAD, inside * ROW_PAD, inside * COLUMN_PAD,
    )  # fmt: skip


@inlined
def _stencil_pointers(s):
    return _StencilPointers(
        ptr(s.steps), ptr(s.quadrant), ptr(s.per_step), ptr(s.place), ptr(s.rise), ptr(s.first), ptr(s.ends),
        ptr(s.weights), ptr(s.above), ptr(s.below),
    )  # fmt: skip


# --- Runs of receivers ------------------------------------------------------------------------------------------------


@inlined
def _faces_up(query, i):
    """Whether the surface of receiver i, if any, hides nothing above the horizontal."""
    if get(query.sides, i) == FREE:
        return True
    upwards = get(query.normals, 3 * i) == 0.0 and get(query.normals, 3 * i + 1) == 0.0
    return upwards and get(query.normals, 3 * i + 2) > 0.0


@inlined
def _is_over(tree, query, i, row, column):
    """Whether receiver i lies above vertex (row, column), or there is no vertex."""
    if get(query.sides, i) == NOTHING or column >= tree.columns:
        return False
    o = get3(query.origins, 3 * i, 1)
    if not (o.x == get(tree.x, column) and o.y == get(tree.y, row) and abs(o.z) <= 4.0 * tree.reach):
        return False
    z = get(tree.z, row * tree.columns + column)
    return not o.z <= z and _faces_up(query, i)  # NaN: there is no vertex


@inlined
def _run_at(tree, relief, query, i, end):
    """The `_Run` that begins with receiver i."""
    o = get3(query.origins, 3 * i, 1)
    column = np.int64(np.rint((np.float64(o.x) - tree.west) * tree.per_x))
    row, n = np.int64(np.rint((tree.north - np.float64(o.y)) * tree.per_y)), np.int64(0)
    if 0 <= row < relief.rows and 0 <= column < tree.columns:
        while n < LANES and i + n < end and _is_over(tree, query, i + n, row, column + n):
            n += 1
    at = (row + relief.row_pad) * relief.stride + column + relief.column_pad
    return _Run(i, row, column, at, (np.int64(1) << n) - 1)


# --- Lanes along a stencil --------------------------------------------------------------------------------------------


@inlined
def _steps_inside(relief, stencils, run, s):
    """The number of steps of a stencil after which all lanes have left the grid."""
    du, dv = get(stencils.per_step, 2 * s), get(stencils.per_step, 2 * s + 1)
    most = np.float64(get(stencils.steps, s + 1) - get(stencils.steps, s))
    columns, rows = relief.columns - relief.column_border, relief.rows - relief.row_border
    column, row = run.column - relief.column_border + LANES, run.row - relief.row_border + 1
    if du != 0.0:
        most = min(most, ((columns - run.column) if du > 0.0 else column) / abs(du) + 1.0)
    if dv != 0.0:
        most = min(most, ((rows - run.row) if dv > 0.0 else row) / abs(dv) + 1.0)
    return np.int64(most)


@inlined
def _block_ahead(relief, stencils, run, level, k):
    """The block, in `tops` and `holes`, of the steps from k on; `level`: its index, the quadrant, its shift."""
    index, quadrant, shift = level
    row = run.row + relief.row_pad + get(stencils.place, 2 * k + 1)
    column = run.column + relief.column_pad + get(stencils.place, 2 * k)
    start = get(relief.starts, 2 * quadrant + index)
    return start + (row >> shift) * get(relief.widths, index) + (column >> shift)


@inlined
def _top_ahead(relief, stencils, run, level, k):
    """The greatest height that lanes may reach in the steps from k on; `level`: as for `_block_ahead`."""
    return get(relief.tops, _block_ahead(relief, stencils, run, level, k))


@inlined
def _edge(heights, stencils, at, e):
    """Heights of the surface at crossing e, and of the lower end of its edge."""
    a = load16(heights, at + get(stencils.ends, 2 * e))
    b = load16(heights, at + get(stencils.ends, 2 * e + 1))
    wa, wb = get(stencils.weights, 2 * e), get(stencils.weights, 2 * e + 1)
    return fma(a, splat16(wa), b * wb), select(a < b, a, b)


@kernel
def _solid_lanes(relief, stencils, run, begin, end):
    """Bits of the lanes whose rays stay over existing triangles in the crossings from `begin` to `end`, exclusive."""
    lowest = load16(relief.low, run.at)
    for e in range(begin, end):
        _, lower = _edge(relief.low, stencils, run.at, e)
        lowest = select(lower < lowest, lower, lowest)
    return bits(lowest > splat16(NO_SURFACE))


@kernel
def _has_holes(relief, stencils, run, s, last):
    """Whether the relief may have holes near a run in the steps of stencil s, of `stencils`, before `last`."""
    quadrant = get(stencils.quadrant, s)
    for k in range(get(stencils.steps, s), last, 2 * _FINE):
        if get(relief.holes, _block_ahead(relief, stencils, run, (0, quadrant, _FINE_SHIFT), k)) != 0:
            return True
    return False


@inlined
def _under(relief, stencils, run, z, s, until, e):
    """Bits of the lanes that have met the surface by crossing e of stencil s, which is in a step before `until`."""
    height, lower = _edge(relief.low, stencils, run.at, e)
    under = bits((z + get(stencils.below, e) < height) & (lower > splat16(NO_SURFACE)))
    if under != 0 and relief.row_border != 0:
        return np.int64(0) if _has_holes(relief, stencils, run, s, until) else under
    if under != 0 and relief.whole == 0:
        under &= _solid_lanes(relief, stencils, run, get(stencils.first, get(stencils.steps, s)), e)
    return under


@kernel
def _march(relief, stencils, run, s, z):
    """Bits of the lanes that are certainly blocked, and of those that are undecided; z : heights of 16 receivers."""
    first, quadrant = get(stencils.steps, s), get(stencils.quadrant, s)
    last = first + _steps_inside(relief, stencils, run, s)
    k, blocked, unsure = first, np.int64(0), np.int64(0)
    heights, waiting = load16(z, 0), run.lanes
    while k < last and waiting != 0:
        lowest = reduce_min(select(mask_from_bits16(waiting), heights, splat16(_FAR))) + get(stencils.rise, k)
        if lowest > relief.highest:
            break
        if k > first:
            if lowest > _top_ahead(relief, stencils, run, (1, quadrant, _COARSE_SHIFT), k):
                k += 2 * _COARSE
                continue
            if lowest > _top_ahead(relief, stencils, run, (0, quadrant, _FINE_SHIFT), k):
                k += 2 * _FINE
                continue
        until = min(k + _STEPS, last)
        for e in range(get(stencils.first, k), get(stencils.first, until)):
            surface, _ = _edge(relief.high, stencils, run.at, e)
            touched = ~bits(heights + get(stencils.above, e) > surface) & waiting  # also where it is NaN
            if touched != 0:
                under = _under(relief, stencils, run, heights, s, until, e) & touched
                blocked, unsure, waiting = blocked | under, unsure | touched, waiting & ~under
        k = until
    return blocked, unsure & ~blocked


@inlined
def _trace_sample(tree, query, i, s, scratch):
    """Whether sample s of receiver i is hidden; exact. `scratch`: (corners, latest blockers)."""
    o, patch, horizon = get3(query.origins, 3 * i, 1), patch_of(query, i), horizon_of(query, i)
    lx, ly, lz = sample_of(query, patch, i, s)
    if not is_above(horizon, lx, ly, lz, query.corners):
        return True
    ray = segment(o.x, o.y, o.z, lx, ly, lz)
    if ray.dx == 0.0 and ray.dy == 0.0 and ray.dz == 0.0:
        return False
    return is_blocked(tree, ray, starts_above(tree, o), scratch, query.facing, s)


@inlined
def _shadow_run(surface, relief, stencils, query, run, scratch, out):
    """Set the bits of the receivers of a run. `scratch`: (corners, latest blockers, 16 heights)."""
    corners, last, z = scratch
    for lane in range(LANES):
        there = run.lanes >> lane & 1
        put(z, lane, get(query.origins, 3 * (run.first + lane) + 2) if there else _FAR)
    for s in range(query.spp):
        blocked, unsure = np.int64(0), run.lanes
        if get(stencils.steps, s + 1) > get(stencils.steps, s):
            blocked, unsure = _march(relief, stencils, run, s, z)
        while unsure != 0:
            lane = lowest_bit(unsure)
            unsure &= unsure - 1
            if _trace_sample(surface, query, run.first + lane, s, (corners, last)):
                blocked |= np.int64(1) << lane
        while blocked != 0:
            set_bit(query, out, run.first + lowest_bit(blocked), s)
            blocked &= blocked - 1


@kernel
def _shadow_runs(ticket, tree, relief, stencils, query, words):
    """Worker: set the bits of all receivers, by runs where they lie above neighbouring vertices."""
    chunk, out, surface = query_pointers(query), ptr(words), terrain_pointers(tree)
    heights, crossings = _relief_pointers(relief, tree), _stencil_pointers(stencils)
    corners, last, z = stack_f32(18), stack_i64(BLOCKERS), stack_f32(LANES)
    for k in items(ticket):
        forget_blockers(last)
        i, end = k * RECEIVERS, min((k + 1) * RECEIVERS, chunk.h * chunk.w)
        while i < end:
            run_ = _run_at(surface, heights, chunk, i, end)
            if run_.lanes != 0:
                _shadow_run(surface, heights, crossings, chunk, run_, (corners, last, z), out)
                i += popcount(run_.lanes)
                continue
            if get(chunk.sides, i) != NOTHING:
                shadow_receiver(surface, chunk, i, (corners, last), out)
            i += 1


def trace_stencils(
    tree: TerrainTree, relief: Relief, stencils: Stencils, query: ShadowQuery, words: NDArray[np.uint64], threads: int,
    progress: ProgressCallback | None,
) -> None:  # fmt: skip
    """`trace_terrain` for a query with the same samples in all sets, and the stencils of their directions."""
    shares = -(-query.sides.size // RECEIVERS)
    run(_shadow_runs, threads, new_ticket(shares, 1), tree, relief, stencils, query, words, progress=progress)
