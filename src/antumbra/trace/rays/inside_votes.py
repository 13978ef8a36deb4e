"""Votes on whether points are inside open surfaces: one ray through the surface, and others through its caps.

Rays along the axes vote, and where they disagree, rays along the space diagonals too (`engine.containment`). A vote is
whether a ray crosses surfaces an odd number of times. The caps of `query.surface_caps` close the surface, so each ray's
parity differs from that of the first ray by the caps that the two cross. The exact rule INSIDE of `all_hits` counts
both, so this holds for every point that is not on a cap.

The first votes are those of all rays about which columns of caps know (`query.cap_columns`), which decide about most
points. The others have only as many rays traced as they need at least for a verdict, then as many again. The rays of
all points of a group form full batches. Bit k of a ballot is the vote of the k-th ray, by the order of votes.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...bvh.nodes import wide_tree_of
from ...kernels.jit import F32Ptr, I32Ptr, inlined, kernel
from ...kernels.marshalling import packed
from ...kernels.parallel import items, new_ticket
from ...kernels.simd import (
    bits,
    fma,
    get,
    load16,
    lowest_bit,
    popcount,
    ptr,
    ptr_at,
    put,
    select,
    splat16,
    stack_f32,
    stack_f64,
    stack_i32,
    store,
    to_i32,
)
from ...query.cap_columns import (
    ALL,
    AWAY,
    AXES,
    LINES,
    WORDS,
    CapColumns,
    CapMesh,
    cap_columns,
    look_up,
    unknown_columns,
)
from ...query.closed_surfaces import open_edges
from ...query.occupancy_grid import FREE, TOUCHED
from ...query.ray_list import RayArguments
from .all_hits import INSIDE, ON_SURFACE, HitSink, walk_batch
from .ray_batches import RayTracer, read_points, run_batches, share_ends
from .wide_traversal import BLOCK_WORDS, BLOCKS, DX, LANES, OX, PRECISE_WORDS, RayBlock, block_of, prepare

MOST = ALL // 2 + 1

OUTSIDE, WITHIN, ON_CAP, UNDECIDED = FREE, 1, 2, TOUCHED
"""Verdicts; ON_CAP: rays through the caps cannot decide; UNDECIDED: a cell does not."""

KNOWN = 4
"""Of cells that decide about no point: the parity of all rays through the surface and its caps is added to it."""

_RAYS = BLOCKS * LANES
_ROWS, _PRECISE = BLOCKS * BLOCK_WORDS, BLOCKS * PRECISE_WORDS
_GROUP = 4 * _RAYS  # points whose rays form batches
_PLACES = 3 * _GROUP
_SIDE = 128  # columns along each side of a grid
_ODD = 16  # of ballots: bits of rays that cross caps an odd number of times come after those of rays that have voted
_ZERO = np.float32(0.0)


class Election(NamedTuple):
    """What the votes of points depend on, besides the caps."""

    crossings: np.ndarray  # (n,) int64: of first rays with the surface, by the rule INSIDE;
    #   or, where the parity of all rays through the surface and its caps is known, -2 for even and -1 for odd
    bounds: np.ndarray  # (2, 3) float32: of the surface; points beyond are outside


# --- Counting votes ---------------------------------------------------------------------------------------------------


_ALONG_AXES = 1 | ((1 << (AXES - 1)) - 1) << (1 + AWAY)
"""The votes of rays along the axes."""

_ALL_VOTES = (1 << ALL) - 1


@inlined
def verdict_of(voted, inside):
    """OUTSIDE or WITHIN, if this no longer depends on rays that have not voted; otherwise UNDECIDED.

    voted, inside : the rays (bits) that have voted, and those of them that vote for inside
    """
    outside = voted & ~inside
    axes, others = inside & _ALONG_AXES, outside & _ALONG_AXES
    all_axes = (voted & _ALONG_AXES) == _ALONG_AXES
    if (popcount(inside) >= MOST and axes != 0) or (all_axes and others == 0):
        return np.int64(WITHIN)
    if (popcount(outside) > ALL - MOST and others != 0) or (all_axes and axes == 0):
        return np.int64(OUTSIDE)
    return np.int64(UNDECIDED)


@inlined
def _needed(voted, inside):
    """How many more rays must vote before there can be a verdict, at least one; see `verdict_of`."""
    yes = popcount(inside)
    return max(min(MOST - yes, ALL + 1 - MOST - popcount(voted) + yes), 1)


# --- Votes without rays -----------------------------------------------------------------------------------------------


@inlined
def _coordinate(block, columns, line, row):
    """Coordinate `row` of the points of a block, in the frame of a line."""
    f, x, y, z = columns.frames, load16(block, OX), load16(block, OX + LANES), load16(block, OX + 2 * LANES)
    rest = fma(z, splat16(f[line, row, 2]), splat16(columns.starts[line, row]))
    return fma(x, splat16(f[line, row, 0]), fma(y, splat16(f[line, row, 1]), rest))


@inlined
def _column(place, last):
    """The number of a column across a line; those at the rims hold all beyond."""
    place = select(place >= _ZERO, place, _ZERO)  # false for NaN
    return to_i32(select(place <= last, place, last))


@inlined
def read_columns(rows, n, columns, ballots):
    """Write what columns say about the rays from the first n points of some blocks.

    ballots : int32 *, for each point; bit k is set if the k-th ray has voted, bit ``_ODD + k`` if it also crosses caps
        an odd number of times
    """
    numbers, depths = stack_i32(_RAYS), stack_f32(_RAYS)
    side = columns.depths.shape[1]
    for at in range(0, n, LANES):
        store(ballots, at, splat16(np.int32(0)))
    for line in range(LINES):
        for at in range(0, n, LANES):
            block, last = ptr_at(rows, at // LANES * BLOCK_WORDS), splat16(np.float32(side - 1))
            u = _column(_coordinate(block, columns, line, 0), last)
            store(numbers, at, u * np.int32(side) + _column(_coordinate(block, columns, line, 1), last))
            store(depths, at, _coordinate(block, columns, line, 2))
        one, other = columns.ends[line, 0], columns.ends[line, 1]
        words = ptr_at(ptr(columns.depths), line * side * side * WORDS)
        for i in range(n):
            said = look_up(ptr_at(words, np.int64(get(numbers, i)) * WORDS), get(depths, i))
            voted, odd = (said & 1) << one | ((said >> 1) & 1) << other, ((said >> 2) & 1) << one | (said >> 3) << other
            put(ballots, i, np.int32(get(ballots, i) | voted | odd << _ODD))


@inlined
def votes_of(ballot, closed):
    """(rays that have voted, those that vote for inside) by a ballot of `read_columns`: bits.

    closed : the parity of all rays through the surface and its caps
    """
    voted = np.int64(ballot) & _ALL_VOTES
    return voted, voted & ((np.int64(ballot) >> _ODD) ^ -np.int64(closed))


# --- The election -----------------------------------------------------------------------------------------------------


class _Voters(NamedTuple):
    """The points of a group: pointers, with an element for each."""

    places: F32Ptr  # float32 *, three for each
    voted: I32Ptr  # int32 *: rays (bits) that have voted
    inside: I32Ptr  # int32 *: those that vote for inside
    odd: I32Ptr  # int32 *: whether the first ray votes for inside, or, once it has voted, a ray that crosses no cap
    pending: I32Ptr  # int32 *: the points without a verdict


class _Slots(NamedTuple):
    """The point and the ray of each of 64 rays that are traced together: pointers."""

    points: I32Ptr  # int32 *
    steps: I32Ptr  # int32 *: the rays, by the order in which they vote


@inlined
def within_box(block, bounds):
    """The points (bits) of a block that are within bounds, (2, 3)."""
    x, y, z = load16(block, OX), load16(block, OX + LANES), load16(block, OX + 2 * LANES)
    inside = (x >= bounds[0, 0]) & (y >= bounds[0, 1]) & (z >= bounds[0, 2])
    return bits(inside & (x <= bounds[1, 0]) & (y <= bounds[1, 1]) & (z <= bounds[1, 2]))


@inlined
def _first_verdict(voters, point, crossings, ballot):
    """The verdict on a point of a group by its ballot."""
    if crossings >= ON_SURFACE:
        return np.int64(WITHIN)
    known, closed = crossings < 0 or (ballot & 1) != 0, crossings & 1  # closed: or of the surface alone
    if crossings >= 0:
        closed ^= (np.int64(ballot) >> _ODD) & 1
    voted, inside = votes_of(ballot, closed)
    put(voters.odd, point, closed)
    put(voters.inside, point, inside)
    put(voters.voted, point, voted if known else voted | _ALL_VOTES + 1)
    return verdict_of(voted, inside) if known else np.int64(UNDECIDED)


@inlined
def _admit(rows, rays, election, columns, voters, first, verdicts):
    """Read a group of points, from `first` on, and write the verdicts without further rays, or UNDECIDED.

    Return how many points are undecided. verdicts : uint8 *, of the group
    """
    left, ballots = 0, stack_i32(_RAYS)
    for begin in range(first, min(first + _GROUP, rays.n), _RAYS):
        within, n = np.int64(0), min(rays.n - begin, _RAYS)
        for j in range((n + LANES - 1) // LANES):
            block = ptr_at(rows, j * BLOCK_WORDS)
            read_points(rays, begin + j * LANES, block)
            within |= within_box(block, election.bounds) << (j * LANES)
        read_columns(rows, n, columns, ballots)
        for i in range(n):
            point, verdict = begin - first + i, np.int64(OUTSIDE)
            if (within >> i) & 1:
                verdict = _first_verdict(voters, point, election.crossings[begin + i], get(ballots, i))
            put(verdicts, point, np.uint8(verdict))
            if verdict == UNDECIDED:
                at = i // LANES * BLOCK_WORDS + OX + i % LANES
                for k in range(3):
                    put(voters.places, 3 * point + k, get(rows, at + k * LANES))
                put(voters.pending, left, np.int32(point))
                left += 1
    return left


@inlined
def _enter(batch, voters, columns, slots, slot, point, step):
    """Give a slot of a batch the ray from a point that votes at a step."""
    rows, lane = block_of(batch, slot // LANES).rows, slot % LANES
    for axis in range(3):
        put(rows, OX + LANES * axis + lane, get(voters.places, 3 * point + axis))
        put(rows, DX + LANES * axis + lane, columns.directions[step, axis])
    put(slots.points, slot, np.int32(point))
    put(slots.steps, slot, np.int32(step))


@inlined
def _count_vote(voters, point, step, crossings):
    """Count the vote of a ray, by its crossings of caps. Return whether the point is on a cap."""
    voted, inside, odd = np.int64(get(voters.voted, point)), np.int64(get(voters.inside, point)), get(voters.odd, point)
    is_first, crossed = voted > _ALL_VOTES, np.int64(crossings & 1)
    voted, vote = (voted & _ALL_VOTES) | 1 << step, np.int64(odd) ^ crossed
    if is_first:  # its vote is that of the surface alone, and the others begin with that of the closed one
        if crossed:
            inside = (voted & ~np.int64(1)) ^ inside
        put(voters.odd, point, np.int32(vote))
        vote = np.int64(odd)
    put(voters.voted, point, np.int32(voted))
    put(voters.inside, point, np.int32(inside | vote << step))
    return is_first and crossings >= ON_SURFACE


@inlined
def _trace(tree, batch, voters, slots, n, sink):
    """Trace the first n slots of a batch and count their votes. Points on caps get all votes at once, marked by -1."""
    for j in range((n + LANES - 1) // LANES):
        prepare(block_of(batch, j).rows, tree.reach)
    walk_batch(tree, batch, np.int64(-1) if n == _RAYS else (np.int64(1) << n) - 1, 0, sink)
    for slot in range(n):
        point = np.int64(get(slots.points, slot))
        if _count_vote(voters, point, np.int64(get(slots.steps, slot)), np.int64(get(sink.counts, slot))):
            put(voters.odd, point, np.int32(-1))


@inlined
def _elect(tree, batch, voters, columns, sink, left, verdicts):
    """Trace rays until all points of a group have a verdict; left: how many have none."""
    slots = _Slots(stack_i32(_RAYS), stack_i32(_RAYS))
    while left > 0:
        slot = 0
        for p in range(left):
            point = np.int64(get(voters.pending, p))
            voted, inside = np.int64(get(voters.voted, point)), np.int64(get(voters.inside, point))
            more = 1 if voted > _ALL_VOTES else _needed(voted, inside)
            steps = np.int64(1) if voted > _ALL_VOTES else _ALL_VOTES & ~voted
            while more > 0 and steps != 0:
                _enter(batch, voters, columns, slots, slot, point, lowest_bit(steps))
                steps &= steps - 1
                more, slot = more - 1, slot + 1
                if slot == _RAYS:
                    _trace(tree, batch, voters, slots, slot, sink)
                    slot = 0
        if slot > 0:
            _trace(tree, batch, voters, slots, slot, sink)
        before, left = left, 0
        for p in range(before):
            point = np.int64(get(voters.pending, p))
            verdict = np.int64(ON_CAP)
            if get(voters.odd, point) >= 0:
                verdict = verdict_of(np.int64(get(voters.voted, point)), np.int64(get(voters.inside, point)))
            put(verdicts, point, np.uint8(verdict))
            if verdict == UNDECIDED:
                put(voters.pending, left, np.int32(point))
                left += 1


@kernel
def _vote(ticket, wide, rays, election, columns, verdicts):
    """Worker: write the verdict on the origin of each of the first rays."""
    # In: wide, rays (a `RayList`), election, columns. Out: verdicts (n,) uint8
    batch = RayBlock(stack_f32(_ROWS), stack_f64(_PRECISE), stack_i32(_RAYS), False)
    voters = _Voters(stack_f32(_PLACES), stack_i32(_GROUP), stack_i32(_GROUP), stack_i32(_GROUP), stack_i32(_GROUP))
    nothing, tree = stack_i32(1), wide_tree_of(wide)
    sink = HitSink(stack_i32(_RAYS), stack_i32(1), nothing, nothing, np.int64(0), INSIDE, stack_f32(1))
    share_ends(rays, batch)
    for g in items(ticket):
        first = g * _GROUP
        written = ptr_at(ptr(verdicts), first)
        left = _admit(batch.rows, rays, election, columns, voters, first, written)
        _elect(tree, batch, voters, columns, sink, left, written)


class Caps:
    """Triangles that close the surfaces of a scene.

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
        self.tracer, self.corners, self._along, self._box = tracer, corners, along, box
        self._columns = packed(unknown_columns(along))
        self._mesh = CapMesh(corners, np.empty((0, 2, 3), np.float32))

    def make_columns(self, threads: int | None) -> None:
        """Make the columns for points; until then, all rays are traced."""
        self._mesh = CapMesh(self.corners, open_edges(self.corners))
        self._columns = packed(self.columns_around(0.0, _SIDE, threads))

    def columns_around(self, around: float | NDArray[np.float64], side: int, threads: int | None) -> CapColumns:
        """Columns for the centres of cells, after `make_columns`.

        around : half the sides of the cells, (3,), or one number
        side : columns along each side of a grid
        """
        return cap_columns(self._mesh, self._along, self._box, side, around, threads)

    def verdicts(self, rays: RayArguments, election: Election, threads: int | None = None) -> NDArray[np.uint8]:
        """(n,) uint8: the verdicts on the origins of first rays: OUTSIDE, WITHIN or ON_CAP."""
        verdicts, ticket = np.empty(rays.n, np.uint8), new_ticket(-(-rays.n // _GROUP), 1)
        run_batches(_vote, threads, ticket, self.tracer.tree, rays.packed(), election, self._columns, verdicts)
        return verdicts
