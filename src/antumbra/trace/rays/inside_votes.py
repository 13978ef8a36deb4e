"""Votes on whether points are inside open surfaces: one ray through the surface, and others through its caps.

Rays along the axes vote, and where they disagree, rays along the space diagonals too (`engine.containment`). A vote is
whether a ray crosses surfaces an odd number of times. The caps of `query.surface_caps` close the surface, so each ray's
parity differs from that of the first ray by the caps that the two cross. The exact rule INSIDE of `all_hits` counts
both, so this holds for every point that is not on a cap.

Sixty-four points vote at a time. The first votes are those of all rays whose columns hold no caps
(`query.cap_columns`), which decide about most points. The others meet again in full batches, and their rays are traced
in turn until no further vote can change the verdict. Bit i of four words counts the votes of point i, so an addition
for all takes four steps.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...bvh.nodes import wide_tree_of
from ...kernels.jit import I64Ptr, inlined, kernel
from ...kernels.parallel import STOP, items, new_ticket
from ...kernels.simd import (
    bits,
    fma,
    gather,
    get,
    load16,
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
    to_i32,
)
from ...query.cap_columns import ALL, AXES, LINES, SIDE, CapColumns, cap_columns, unknown_columns
from ...query.ray_list import RayArguments
from .all_hits import INSIDE, ON_SURFACE, HitSink, walk_batch
from .ray_batches import RayTracer, read_batch, run_batches
from .row_tiles import line_of
from .wide_traversal import (
    BLOCK_WORDS,
    BLOCKS,
    DX,
    LANES,
    OX,
    PRECISE_WORDS,
    RayBlock,
    block_of,
    prepare,
    rays_of_block,
)

MOST = ALL // 2 + 1

OUTSIDE, WITHIN, ON_CAP, UNDECIDED = range(4)
"""Verdicts; ON_CAP: rays through the caps cannot decide; UNDECIDED: they have not been traced."""

_RAYS = BLOCKS * LANES
_ROWS, _PRECISE = BLOCKS * BLOCK_WORDS, BLOCKS * PRECISE_WORDS
_CHUNK = 16  # batches that a thread takes at a time
_COLUMNS_PAY, _CAPS_PAY = 10_000, 4  # points that save as much time by columns as these take to make; and per cap
_FIRST, _LAST = np.float32(0.0), np.float32(SIDE - 1)  # columns
_AWAY = AXES + (ALL - AXES) // 2  # diagonals before this one lead away from most caps


class Election(NamedTuple):
    """What the votes of points depend on, besides the caps."""

    crossings: np.ndarray  # (n,) int64: of each first ray with the surface, by the rule INSIDE
    bounds: np.ndarray  # (2, 3) float32: of the surface; points beyond are outside


# --- Counting votes ---------------------------------------------------------------------------------------------------


class _Poll(NamedTuple):
    """The votes of 64 points so far, as bits: two numbers of four digits each, and the points with some vote."""

    inside: tuple[int, int, int, int]
    outside: tuple[int, int, int, int]
    axis_inside: int  # points for which a ray along an axis votes for inside
    axis_outside: int


@inlined
def _no_votes():
    zero = np.int64(0)
    return _Poll((zero, zero, zero, zero), (zero, zero, zero, zero), zero, zero)


@inlined
def _plus(votes, more):
    """A number of votes after one more of the points in `more` (bits)."""
    a, b, c, d = votes
    return a ^ more, b ^ (a & more), c ^ (a & b & more), d ^ (a & b & c & more)


@inlined
def _at_least(votes, number):
    """The points (bits) with at least a number of votes, 0 to 14."""
    reached = np.int64(-1)
    for digit in range(4):
        reached = votes[digit] & reached if (number >> digit) & 1 else votes[digit] | reached
    return reached


@inlined
def _after(poll, k, points, inside):
    """The poll after ray k of some points (bits) has voted; inside: those for which it votes for inside."""
    yes, no = points & inside, points & ~inside
    axis = -np.int64(k < AXES)
    axis_inside, axis_outside = poll.axis_inside | (yes & axis), poll.axis_outside | (no & axis)
    return _Poll(_plus(poll.inside, yes), _plus(poll.outside, no), axis_inside, axis_outside)


@inlined
def _verdicts_of(poll, voted):
    """The points (bits) that are inside, and outside, whatever the rays vote that have not.

    voted : int64 *, 14: the points for which each ray has voted
    """
    all_axes = np.int64(-1)
    for k in range(AXES):
        all_axes &= get(voted, k)
    inside = (_at_least(poll.inside, MOST) & poll.axis_inside) | (all_axes & ~poll.axis_outside)
    outside = (_at_least(poll.outside, ALL + 1 - MOST) & poll.axis_outside) | (all_axes & ~poll.axis_inside)
    return inside, outside


# --- Rays that miss all caps ------------------------------------------------------------------------------------------


@inlined
def _coordinate(block, columns, line, row):
    """Coordinate `row` of the points of a block, in the frame of a line."""
    f, x, y, z = columns.frames, load16(block, OX), load16(block, OX + LANES), load16(block, OX + 2 * LANES)
    rest = fma(z, splat16(f[line, row, 2]), splat16(columns.starts[line, row]))
    return fma(x, splat16(f[line, row, 0]), fma(y, splat16(f[line, row, 1]), rest))


@inlined
def _column(place):
    """The number of a column across a line; those at the rims hold all beyond."""
    place = select(place >= _FIRST, place, _FIRST)  # false for NaN
    return to_i32(select(place <= _LAST, place, _LAST))


@inlined
def _find_clear(rows, columns, clear):
    """Write, for each direction, the points (bits) from which no cap is in the ray's column."""
    depths = ptr(columns.depths)
    for line in range(LINES):
        ahead, behind = np.int64(0), np.int64(0)
        for j in range(BLOCKS):
            block = ptr_at(rows, j * BLOCK_WORDS)
            u, v = _column(_coordinate(block, columns, line, 0)), _column(_coordinate(block, columns, line, 1))
            depth, at = _coordinate(block, columns, line, 2), ((u + np.int32(line * SIDE)) * np.int32(SIDE) + v) << 1
            ahead |= bits(depth > gather(depths, at + np.int32(1))) << (j * LANES)
            behind |= bits(depth < gather(depths, at)) << (j * LANES)
        put(clear, columns.ends[line, 0], ahead)
        put(clear, columns.ends[line, 1], behind)


# --- The election -----------------------------------------------------------------------------------------------------


class _Candidates(NamedTuple):
    """A batch of points: bits of points, and a pointer."""

    points: int  # those that vote
    odd: int  # those whose first ray votes for inside
    clear: I64Ptr  # int64 *, 14: those whose rays along each direction cross no cap


@inlined
def _within(rows, bounds):
    """The points (bits) within bounds."""
    points = np.int64(0)
    for j in range(BLOCKS):
        block = ptr_at(rows, j * BLOCK_WORDS)
        x, y, z = load16(block, OX), load16(block, OX + LANES), load16(block, OX + 2 * LANES)
        inside = (x >= bounds[0, 0]) & (y >= bounds[0, 1]) & (z >= bounds[0, 2])
        points |= bits(inside & (x <= bounds[1, 0]) & (y <= bounds[1, 1]) & (z <= bounds[1, 2])) << (j * LANES)
    return points


@inlined
def _turn(batch, alive, directions, k, reach):
    """Give the rays in `alive` (bits) direction k."""
    for j in range(BLOCKS):
        if alive & rays_of_block(j):
            rows = block_of(batch, j).rows
            for axis in range(3):
                store(rows, DX + LANES * axis, splat16(directions[k, axis]))
            prepare(rows, reach)


@inlined
def _found(counts, alive):
    """(rays (bits) that cross caps an odd number of times, those whose origin is on a cap)."""
    odd, touching = np.int64(0), np.int64(0)
    for j in range(BLOCKS):
        n = load16(counts, j * LANES)
        odd |= bits((n & np.int32(1)) != np.int32(0)) << (j * LANES)
        touching |= bits(n >= np.int32(ON_SURFACE)) << (j * LANES)
    return odd & alive, touching & alive


@inlined
def _clear_votes(clear, base):
    """The poll after all rays that cross no cap have voted, as `base` does (bits)."""
    poll = _no_votes()
    for k in range(ALL):
        poll = _after(poll, k, get(clear, k), base)
    return poll


@inlined
def _decide_early(candidates):
    """(bits of the points inside, of those undecided), by the rays that cross no cap."""
    points, odd, clear = candidates
    won, lost = _verdicts_of(_clear_votes(clear, odd), clear)
    settled = (won | lost) & get(clear, 0)
    return points & settled & won, points & ~settled


@inlined
def _traced_at(step):
    """The ray that is traced at a step: the first one, diagonals that lead away from caps, axes, other diagonals."""
    k = step + AXES - 1 if step <= _AWAY - AXES else step - (_AWAY - AXES)
    return step if step == 0 or step >= _AWAY else k


@inlined
def _elect(tree, batch, candidates, columns, sink):
    """(bits of the points inside, of those on a cap). It changes the points whose rays are `clear`."""
    points, base, clear = candidates
    inside, on_cap, poll = np.int64(0), np.int64(0), _no_votes()
    for step in range(ALL):
        k = _traced_at(step)
        alive, crossed = points & ~get(clear, k), np.int64(0)
        if alive:
            if k > 0:
                _turn(batch, alive, columns.directions, k, tree.reach)
            walk_batch(tree, batch, alive, 0, sink)
            crossed, touching = _found(sink.counts, alive)
            if k == 0:
                on_cap, base = touching, base ^ crossed
                points &= ~touching
        if k == 0:
            poll = _clear_votes(clear, base)
        poll = _after(poll, k, alive, base ^ crossed)
        put(clear, k, np.int64(-1))  # all points left have voted
        won, lost = _verdicts_of(poll, clear)
        inside, points = inside | (won & points), points & ~won & ~lost
        if points == 0:
            break
    return inside, on_cap


class _Results(NamedTuple):
    """What `_vote` writes."""

    verdicts: np.ndarray  # (n,) uint8
    faults: np.ndarray  # (1,) bool: whether a ray is invalid


@kernel
def _vote(ticket, wide, rays, election, columns, traces, out):
    """Worker: write the verdict on the origin of each of the first rays."""
    # In: wide, rays (a `RayList`), election, columns, traces (bool). Out: out (`_Results`)
    batch = RayBlock(stack_f32(_ROWS), stack_f64(_PRECISE), stack_i32(_RAYS), False)
    nothing, clear, tree = stack_i32(1), stack_i64(ALL), wide_tree_of(wide)
    sink = HitSink(stack_i32(_RAYS), stack_i32(1), nothing, nothing, np.int64(0), INSIDE, stack_f32(1))
    for b in items(ticket):
        n, points, good = read_batch(tree, rays, line_of(b * _RAYS), batch)
        if not good:
            out.faults[0], ticket[STOP] = True, 1
            break
        odd, on_surface = np.int64(0), np.int64(0)
        for i in range(n):
            crossings = election.crossings[b * _RAYS + i]
            odd |= (crossings & 1) << i
            on_surface |= np.int64(crossings >= ON_SURFACE) << i
        points &= _within(batch.rows, election.bounds)
        _find_clear(batch.rows, columns, clear)
        candidates = _Candidates(points & ~on_surface, odd, clear)
        if traces:
            inside, on_cap = _elect(tree, batch, candidates, columns, sink)
            undecided = np.int64(0)
        else:
            inside, undecided = _decide_early(candidates)
            on_cap = np.int64(0)
        inside |= on_surface
        for i in range(n):
            verdict = ((inside >> i) & 1) * WITHIN | ((on_cap >> i) & 1) * ON_CAP
            out.verdicts[b * _RAYS + i] = verdict | ((undecided >> i) & 1) * UNDECIDED


class Caps:
    """Triangles that close the surfaces of a scene. Their columns are made once points have taken as long (ski rental).

    corners : (n, 3, 3) float32, the triangles that `tracer` traces
    along : (3,), the direction of first rays
    box : (2, 3) float32, bounds of the scene
    """

    def __init__(
        self,
        tracer: RayTracer,
        corners: NDArray[np.float32],
        along: NDArray[np.floating],
        box: NDArray[np.float32],
    ) -> None:
        self._tracer, self._corners, self._along, self._box = tracer, corners, along, box
        self._columns, self._is_made, self._points = unknown_columns(along), False, 0

    def _columns_for(self, points: int, threads: int | None) -> CapColumns:
        """The columns for a number of points."""
        self._points += points
        if not self._is_made and self._points >= _COLUMNS_PAY + _CAPS_PAY * len(self._corners):
            self._columns, self._is_made = cap_columns(self._corners, self._along, self._box, threads), True
        return self._columns

    def verdicts(
        self, rays: RayArguments, election: Election, traces: bool, threads: int | None = None
    ) -> NDArray[np.uint8] | None:
        """(n,) uint8: the verdicts on the origins of first rays; None if a ray is invalid.

        traces : whether rays are traced through caps; otherwise, points stay undecided where this is necessary
        """
        n, columns, faults = rays.n, self._columns_for(rays.n, threads), np.zeros(1, np.bool_)
        verdicts, ticket = np.empty(n, np.uint8), new_ticket(-(-n // _RAYS), _CHUNK)
        args = self._tracer.tree, rays.packed(), election, columns, traces, _Results(verdicts, faults)
        run_batches(_vote, threads, ticket, *args)
        return None if faults[0] else verdicts
