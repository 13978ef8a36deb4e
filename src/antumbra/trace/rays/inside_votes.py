"""Votes on whether points are inside open surfaces: one ray through the surface, and others through its caps.

Rays along the axes vote, and where they disagree, rays along the space diagonals too (`engine.containment`). A vote is
whether a ray crosses surfaces an odd number of times. The caps of `query.surface_caps` close the surface, so each ray's
parity differs from that of the first ray by the caps that the two cross. The exact rule INSIDE of `all_hits` counts
both, so this holds for every point that is not on a cap.

Sixty-four points vote at a time. Bit i of four words counts the votes of point i, so that an addition takes four steps
for all of them. Rays that leave the bounds of the caps are not traced.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...bvh.nodes import wide_tree_of
from ...kernels.jit import inlined, kernel
from ...kernels.parallel import STOP, items, new_ticket
from ...kernels.simd import bits, get, load16, put, splat16, stack_f32, stack_f64, stack_i32, stack_i64, store
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

AXES, ALL = 6, 14  # rays along the axes, and with the diagonals
MOST = ALL // 2 + 1

OUTSIDE, WITHIN, ON_CAP = range(3)
"""Verdicts; ON_CAP: rays through the caps cannot decide."""

_RAYS = BLOCKS * LANES
_ROWS, _PRECISE = BLOCKS * BLOCK_WORDS, BLOCKS * PRECISE_WORDS
_CHUNK = 16  # batches that a thread takes at a time


class Election(NamedTuple):
    """What the votes of points depend on, besides the caps."""

    crossings: np.ndarray  # (n,) int64: of each first ray with the surface, by the rule INSIDE
    directions: np.ndarray  # (14, 3) float32 of -1, 0 and 1: that of the first rays, the other axes, the diagonals
    bounds: np.ndarray  # (2, 3) float32: of the surface; points beyond are outside


@inlined
def _plus(votes, more):
    """Votes after one more of the points in `more` (bits)."""
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
def _compare(rows, bounds, sides):
    """Write the points (bits) not above the upper bound along each axis, and those not below the lower one."""
    for axis in range(3):
        below, above = np.int64(0), np.int64(0)
        for j in range(BLOCKS):
            x = load16(rows, j * BLOCK_WORDS + OX + LANES * axis)
            below |= bits(x <= bounds[1, axis]) << (j * LANES)
            above |= bits(x >= bounds[0, axis]) << (j * LANES)
        put(sides, axis, below)
        put(sides, 3 + axis, above)


@inlined
def _towards(sides, directions, k):
    """The points (bits) from which rays along direction k may meet bounds; sides: from `_compare`."""
    points = np.int64(-1)
    for axis in range(3):
        if directions[k, axis] >= 0.0:
            points &= get(sides, axis)
        if directions[k, axis] <= 0.0:
            points &= get(sides, 3 + axis)
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
def _elect(tree, batch, points, odd, election, cap_bounds, sink):
    """(bits of the `points` inside, of those on a cap); odd: bits of the points whose first ray votes for inside."""
    sides, votes = stack_i64(6), (np.int64(0), np.int64(0), np.int64(0), np.int64(0))
    inside, on_cap, base, directions = np.int64(0), np.int64(0), np.int64(0), election.directions
    _compare(batch.rows, cap_bounds, sides)
    for k in range(ALL):
        alive, crossed = points & _towards(sides, directions, k), np.int64(0)
        if alive:
            if k > 0:
                _turn(batch, alive, directions, k, tree.reach)
            walk_batch(tree, batch, alive, 0, sink)
            crossed, touching = _found(sink.counts, alive)
            if k == 0:
                on_cap, points = touching, points & ~touching
        if k == 0:
            base = odd ^ crossed
        votes = _plus(votes, (base ^ crossed) & points)
        if k == AXES - 1:
            agreed = _at_least(votes, AXES)
            inside, points = agreed & points, points & ~agreed & _at_least(votes, 1)
        elif k >= AXES:
            won = _at_least(votes, MOST)
            inside, points = inside | (won & points), points & ~won & _at_least(votes, MOST - (ALL - 1 - k))
        if points == 0:
            break
    return inside, on_cap


@kernel
def _vote(ticket, wide, rays, election, cap_bounds, verdicts, faults):
    """Worker: write the verdict on the origin of each of the first rays."""
    # In: wide, rays (a `RayList`), election, cap_bounds. Out: verdicts, (n,) uint8; faults
    batch = RayBlock(stack_f32(_ROWS), stack_f64(_PRECISE), stack_i32(_RAYS), False)
    nothing, sides, tree = stack_i32(1), stack_i64(6), wide_tree_of(wide)
    sink = HitSink(stack_i32(_RAYS), stack_i32(1), nothing, nothing, np.int64(0), INSIDE, stack_f32(1))
    for b in items(ticket):
        n, points, good = read_batch(tree, rays, line_of(b * _RAYS), batch)
        if not good:
            faults[0], ticket[STOP] = True, 1
            break
        odd, on_surface = np.int64(0), np.int64(0)
        for i in range(n):
            crossings = election.crossings[b * _RAYS + i]
            odd |= (crossings & 1) << i
            on_surface |= np.int64(crossings >= ON_SURFACE) << i
        _compare(batch.rows, election.bounds, sides)
        for k in range(6):
            points &= get(sides, k)
        inside, on_cap = _elect(tree, batch, points & ~on_surface, odd, election, cap_bounds, sink)
        inside |= on_surface
        for i in range(n):
            verdicts[b * _RAYS + i] = ((inside >> i) & 1) * WITHIN | ((on_cap >> i) & 1) * ON_CAP


class Caps(NamedTuple):
    """Triangles that close the surfaces of a scene."""

    tracer: RayTracer
    bounds: NDArray[np.float32]  # (2, 3), in the frame

    def verdicts(self, rays: RayArguments, election: Election, threads: int | None = None) -> NDArray[np.uint8] | None:
        """(n,) uint8: the verdicts on the origins of first rays; None if a ray is invalid."""
        n, faults = rays.n, np.zeros(1, np.bool_)
        verdicts, ticket = np.empty(n, np.uint8), new_ticket(-(-n // _RAYS), _CHUNK)
        args = self.tracer.tree, rays.packed(), election, self.bounds, verdicts, faults
        run_batches(_vote, threads, ticket, *args)
        return None if faults[0] else verdicts
