"""Cell verdicts: what an occupancy grid knows about all points of a cell.

One ray per region of free cells decides (`query.occupancy_grid`). Where surfaces are closed, this is the verdict. Where
they are open, it is the parity of all rays through the surface and its caps (`inside_votes`). Rays that cross caps
equally often from anywhere in a cell vote for all of its points, and in most cells, no other votes are needed.
"""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...kernels.jit import inlined, kernel
from ...kernels.marshalling import ArgumentForm, Packed, address_of, packed
from ...kernels.parallel import items, new_ticket, run, thread_count
from ...kernels.simd import atomic_add, get, load16, put, select, splat16, stack_f32, stack_i32, store, to_i32
from ...query.occupancy_grid import OccupancyGrid, occupancy_grid, regions_of, touch
from ...query.ray_list import RayArguments, rays_along
from .all_hits import INSIDE, count_all
from .inside_votes import KNOWN, OUTSIDE, UNDECIDED, WITHIN, Caps, read_columns, verdict_of, votes_of, within_box
from .ray_batches import read_points, run_batches
from .wide_traversal import BLOCK_WORDS, BLOCKS, LANES, OX

_RAYS = BLOCKS * LANES
_ROWS = BLOCKS * BLOCK_WORDS
_CHUNK = 16  # batches of points that a thread takes at a time
_CELLS = 64  # batches of cells
_MANY = 1 << 16  # points that are looked up by several threads
_GRID_PAYS = 10_000
"""Points after which a grid is made. It takes as long as up to 50,000 points, but far less than the tree before."""

_SIDE = 64  # columns along each side of a grid of caps
_AROUND = 0.51  # half a cell, and what rounding may move a point beyond it

# --- Making a grid ----------------------------------------------------------------------------------------------------


@kernel
def _decide_cells(ticket, grid, sides, regions, odd, columns):
    """Worker: write the verdict on all points of each free cell, or KNOWN."""
    # In: sides (3,) float64, of cells, regions (n,) int32, odd (n,) uint8, by first cell of a region, columns.
    # Out: grid (`OccupancyGrid`)
    rows, ballots = stack_f32(_ROWS), stack_i32(_RAYS)
    lower = grid.box
    for b in items(ticket):
        first = b * _RAYS
        last = min(first + _RAYS, len(grid.cells))
        for cell in range(first, last):
            i, x, row = cell - first, cell % grid.nx, cell // grid.nx
            at = i // LANES * BLOCK_WORDS + OX + i % LANES
            put(rows, at, np.float32(lower[0, 0] + (x + 0.5) * sides[0]))
            put(rows, at + LANES, np.float32(lower[0, 1] + (row % grid.ny + 0.5) * sides[1]))
            put(rows, at + 2 * LANES, np.float32(lower[0, 2] + (row // grid.ny + 0.5) * sides[2]))
        read_columns(rows, last - first, columns, ballots)
        for cell in range(first, last):
            if regions[cell] >= 0:
                closed = np.int64(odd[regions[cell]])
                voted, inside = votes_of(get(ballots, cell - first), closed)
                verdict = verdict_of(voted, inside)
                grid.cells[cell] = verdict if verdict != UNDECIDED else KNOWN + closed


# --- Looking points up ------------------------------------------------------------------------------------------------


@inlined
def _cells_of(rows, grid):
    """The numbers of the cells, 16 int32, of the points of a block; those nearest to points beyond the box."""
    number, zero = splat16(np.int32(0)), splat16(np.float32(0.0))
    for k in range(3):
        axis = 2 - k
        n = grid.nz if axis == 2 else grid.ny if axis == 1 else grid.nx
        place = (load16(rows, OX + LANES * axis) - grid.box[0, axis]) * grid.scale[axis]
        most = splat16(np.float32(n - 1))
        place = select(place >= zero, place, zero)  # false for NaN
        number = number * np.int32(n) + to_i32(select(place <= most, place, most))
    return number


class FoundCells(NamedTuple):
    """What the cells of points decide."""

    inside: np.ndarray  # (n,) bool: False for points without a verdict
    places: np.ndarray  # (m,) int64: the points without a verdict; first those of which nothing is known
    points: np.ndarray  # (m, 3) float32: in the scene's frame
    crossings: np.ndarray  # (m,) int64: as in an `Election`, of the others
    counts: np.ndarray  # (2,) int64: number of points of which nothing is known, and of the others

    @property
    def unknown(self) -> int:
        """The number of points of which nothing is known."""
        return int(self.counts[0])

    def packed(self) -> Packed:
        """Arrays for n points as a kernel argument, which they must outlive."""
        inside, places, points, crossings, counts = self
        n = len(inside)
        return _FOUND.pack(
            address_of(inside), n, 1, address_of(places), n, 8, address_of(points), n, 3, 12, 4,
            address_of(crossings), n, 8, address_of(counts), 2, 8,
        )  # fmt: skip

    def without_gap(self) -> "FoundCells":
        """The m points without a verdict, from arrays for n that `_look_up` has filled from both ends."""
        unknown, known = self.counts.tolist()
        if not known:
            places, points, crossings = (each[:unknown] for each in self[1:4])
        else:
            end = len(self.inside) - known
            places, points, crossings = (np.concatenate((each[:unknown], each[end:])) for each in self[1:4])
        return FoundCells(self.inside, places, points, crossings, self.counts)


def _cells_found(n: int) -> FoundCells:
    """Arrays for n points."""
    places, points, crossings = np.empty(n, np.int64), np.empty((n, 3), np.float32), np.empty(n, np.int64)
    return FoundCells(np.empty(n, np.bool_), places, points, crossings, np.zeros(2, np.int64))


_FOUND = ArgumentForm(_cells_found(0))


@inlined
def _collect(rows, lane, point, verdict, found):
    """Add a point without a verdict, in a lane of a block, to those found; known ones from the end of the arrays."""
    known = verdict > UNDECIDED
    place = atomic_add(found.counts, np.int64(known), 1)
    if known:
        place = len(found.places) - 1 - place
    found.crossings[place], found.places[place] = verdict - (KNOWN + 2), point
    for axis in range(3):
        found.points[place, axis] = get(rows, OX + LANES * axis + lane)


@kernel
def _look_up(ticket, rays, grid, found):
    """Worker: write the verdicts that the grid holds on the origins of rays, and collect those without one."""
    # In: rays (a `RayList`), grid (`OccupancyGrid`). Out: found (`FoundCells`)
    rows, cells = stack_f32(BLOCK_WORDS), stack_i32(LANES)
    for b in items(ticket):
        for first in range(b * _RAYS, min((b + 1) * _RAYS, rays.n), LANES):
            read_points(rays, first, rows)
            there = within_box(rows, grid.box)
            store(cells, 0, _cells_of(rows, grid))
            for i in range(min(rays.n - first, LANES)):
                verdict = np.int64(OUTSIDE)
                if (there >> i) & 1:
                    verdict = np.int64(grid.cells[np.int64(get(cells, i))])
                found.inside[first + i] = verdict == WITHIN
                if verdict >= UNDECIDED:
                    _collect(rows, i, first + i, verdict, found)


class CellVerdicts:
    """Verdicts on the points of a scene in memory by their cells, once a number of points has come.

    corners : (n, 3, 3) float32, of all triangles that count
    box : (2, 3) float32, their bounds
    crossings : counts first rays by the rule INSIDE, on some threads
    along : (3,), the direction of first rays
    caps : that close the surface; None: it is closed
    """

    def __init__(
        self,
        corners: NDArray[np.float32],
        box: NDArray[np.float32],
        crossings: Callable[[RayArguments, int], NDArray[np.int64]],
        along: NDArray[np.floating],
        caps: Caps | None,
    ) -> None:
        self._corners, self._box, self._crossings = corners, box, crossings
        self._along, self._caps = along.astype(np.float32), caps
        self._points = 0
        self._grid: OccupancyGrid | None = None
        self._packed: Packed | None = None  # the grid, as an argument of kernels

    def of(self, rays: RayArguments, threads: int) -> FoundCells | None:
        """What the cells decide about the origins of rays; None as long as there is no grid."""
        before, self._points = self._points, self._points + rays.n
        if before < _GRID_PAYS <= self._points:
            self._grid = self._made_grid(rays.time, threads)
            self._packed = None if self._grid is None else packed(self._grid)
        if self._packed is None:
            return None
        n, found = rays.n, _cells_found(rays.n)
        ticket = new_ticket(-(-n // _RAYS), _CHUNK)
        run_batches(_look_up, threads if n >= _MANY else 1, ticket, rays.packed(), self._packed, found.packed())
        return found.without_gap()

    def _made_grid(self, time: float, threads: int) -> OccupancyGrid | None:
        grid, caps = occupancy_grid(self._box, len(self._corners)), self._caps
        if caps is not None:
            caps.make_columns(threads)
        if grid is None or not touch(grid, self._corners, threads):
            return None
        if caps is not None and not touch(grid, caps.corners, threads):
            return None
        regions = regions_of(grid)
        first = np.flatnonzero(regions == np.arange(len(regions), dtype=np.int32))
        odd = np.zeros(len(regions), np.uint8)
        odd[first] = self._parities(grid.centres(first), time, threads)
        if caps is None:
            free = regions >= 0
            grid.cells[free] = odd[regions[free]]
        else:
            columns = caps.columns_around(_AROUND * grid.sides, _SIDE, threads)
            ticket = new_ticket(-(-len(regions) // _RAYS), _CELLS)
            run(_decide_cells, thread_count(threads), ticket, grid, grid.sides, regions, odd, columns)
        return grid

    def _parities(self, points: NDArray[np.float32], time: float, threads: int) -> NDArray[np.int64]:
        """(m,) int64, 0 or 1: of rays from points through the closed surface."""
        rays = rays_along(points, self._along, time=time)
        crossings = self._crossings(rays, threads)
        if self._caps is not None:
            through_caps = count_all(self._caps.tracer, rays, INSIDE, threads)
            assert through_caps is not None
            crossings = crossings + through_caps
        return crossings & 1
