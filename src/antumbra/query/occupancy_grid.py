"""Occupancy grid: cells over a scene, as many along each axis, and which of them no triangle touches.

Two points that a path of untouched cells joins lie on the same side of every surface. Where surfaces and their caps are
closed together, rays from both cross them equally often, modulo 2, in all directions. So one ray decides for a whole
region of cells, and most points need only a look into their cell.

Rounding. A point's cell is computed in float32, from a difference and a product, which moves the point by less than
``3 * 2**-24`` of its distance from the lower corner: less than 2**-12 cells, of at most 101 along an axis. Triangles
touch all cells that they reach with a margin of ``_MARGIN`` cells.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..kernels.jit import inlined, kernel
from ..kernels.parallel import STOP, items, new_ticket, run, thread_count

_FEWEST, _MOST = 1 << 16, 1 << 20  # cells
_CELLS_PER_FACE = 4
_MARGIN, _HALF = 2.0**-10, 0.5 + 2.0**-10
_SLIVER = 2.0**-40  # of its longest edges: how far off the plane of a thin triangle may be
_FINEST = 2.0**-14  # side of a cell, relative to the coordinates, from which on its points round into it
_SMALLEST = 2.0**-80  # extent
_MOST_TOUCHED = 1 << 26  # cells around all triangles, which take a tenth of a second
_CHUNK = 256  # triangles that a thread takes at a time

FREE, TOUCHED = 0, 3


class OccupancyGrid(NamedTuple):
    """Cells of a box, x fastest."""

    box: np.ndarray  # (2, 3) float32: bounds of the points that have a cell
    scale: np.ndarray  # (3,) float32: cells per unit of length; 0: there is one
    nx: int
    ny: int
    nz: int
    cells: np.ndarray  # (nx * ny * nz,) uint8: FREE, TOUCHED, or what the owner writes

    @property
    def sides(self) -> NDArray[np.float64]:
        """(3,): the sides of a cell."""
        extent = np.subtract(*self.box[::-1].astype(np.float64))
        return np.divide(1.0, self.scale.astype(np.float64), out=extent, where=self.scale > 0.0)

    def centres(self, cells: NDArray[np.integer]) -> NDArray[np.float32]:
        """(m, 3) float32: the centres of cells, (m,) int."""
        x, rows = cells % self.nx, cells // self.nx
        steps = np.stack([x, rows % self.ny, rows // self.ny], axis=1) + 0.5
        return np.asarray(self.box[0].astype(np.float64) + steps * self.sides, np.float32)


def occupancy_grid(box: NDArray[np.float32], n_faces: int) -> OccupancyGrid | None:
    """A grid of free cells over a box, (2, 3), for a number of faces. None if float32 is too coarse for it."""
    extent, farthest = np.subtract(*box[::-1].astype(np.float64)), np.abs(box).max(axis=0)
    n = round(min(max(_CELLS_PER_FACE * n_faces, _FEWEST), _MOST) ** (1 / 3))
    fits = (extent > n * _FINEST * farthest) & (extent > _SMALLEST) & (extent < 1.0 / _SMALLEST)
    if not fits.any():
        return None
    # the last cell ends beyond the box
    scale = np.where(fits, (n - 2.0**-6) / np.where(fits, extent, 1.0), 0.0).astype(np.float32)
    nx, ny, nz = (n if each else 1 for each in fits.tolist())
    return OccupancyGrid(box, scale, nx, ny, nz, np.full(nx * ny * nz, FREE, np.uint8))


# --- Touched cells ----------------------------------------------------------------------------------------------------


class _Plane(NamedTuple):
    """A slab around the plane of a triangle, in cells: the normal, and the greatest distance times its length."""

    x: float
    y: float
    z: float
    height: float
    reach: float


@inlined
def _range_of(corners, i, k, grid):
    """(first, last cell along axis k that triangle i reaches)."""
    n = grid.nx if k == 0 else grid.ny if k == 1 else grid.nz
    low = np.float64(grid.box[0, k])
    a, b, c = np.float64(corners[i, 0, k]), np.float64(corners[i, 1, k]), np.float64(corners[i, 2, k])
    scale = np.float64(grid.scale[k])
    least, greatest = (min(a, b, c) - low) * scale, (max(a, b, c) - low) * scale
    return max(np.int64(least - _MARGIN), 0), min(np.int64(greatest + _MARGIN), n - 1)


@inlined
def _plane_of(corners, i, grid):
    """The `_Plane` of triangle i, relative to the lower corner of the grid."""
    lower, sx, sy, sz = grid.box, np.float64(grid.scale[0]), np.float64(grid.scale[1]), np.float64(grid.scale[2])
    ax, ay, az = np.float64(corners[i, 0, 0]), np.float64(corners[i, 0, 1]), np.float64(corners[i, 0, 2])
    bx, by, bz = (corners[i, 1, 0] - ax) * sx, (corners[i, 1, 1] - ay) * sy, (corners[i, 1, 2] - az) * sz
    cx, cy, cz = (corners[i, 2, 0] - ax) * sx, (corners[i, 2, 1] - ay) * sy, (corners[i, 2, 2] - az) * sz
    x, y, z = by * cz - bz * cy, bz * cx - bx * cz, bx * cy - by * cx
    height = x * (ax - lower[0, 0]) * sx + y * (ay - lower[0, 1]) * sy + z * (az - lower[0, 2]) * sz
    longest = (abs(bx) + abs(by) + abs(bz)) * (abs(cx) + abs(cy) + abs(cz))
    return _Plane(x, y, z, height, _HALF * (abs(x) + abs(y) + abs(z)) + _SLIVER * longest)


@kernel
def _touch(ticket, corners, grid, faults):
    """Worker: mark the cells that triangles touch. All threads write the same, so order does not matter."""
    # In: corners (n, 3, 3) float32. Out: grid (`OccupancyGrid`), faults (1,) bool: whether this takes too long
    entered = 0
    for i in items(ticket):
        (x0, x1), (y0, y1), (z0, z1) = (
            _range_of(corners, i, 0, grid), _range_of(corners, i, 1, grid), _range_of(corners, i, 2, grid)
        )  # fmt: skip
        plane = _plane_of(corners, i, grid)
        entered += (x1 - x0 + 1) * (y1 - y0 + 1) * (z1 - z0 + 1)
        if entered > _MOST_TOUCHED:
            faults[0], ticket[STOP] = True, 1
            break
        for z in range(z0, z1 + 1):
            for y in range(y0, y1 + 1):
                row, rest = (z * grid.ny + y) * grid.nx, (y + 0.5) * plane.y + (z + 0.5) * plane.z - plane.height
                for x in range(x0, x1 + 1):
                    if abs((x + 0.5) * plane.x + rest) <= plane.reach:
                        grid.cells[row + x] = TOUCHED


def touch(grid: OccupancyGrid, corners: NDArray[np.float32], threads: int | None = None) -> bool:
    """Mark the cells that triangles, (n, 3, 3), touch. False if this takes too long; then, not all are marked."""
    faults = np.zeros(1, np.bool_)
    run(_touch, thread_count(threads), new_ticket(len(corners), _CHUNK), corners, grid, faults)
    return not faults[0]


# --- Regions ----------------------------------------------------------------------------------------------------------


@inlined
def _first_of(regions, cell):
    """The first cell of the region that a cell belongs to, as far as known. Shortens the path to it."""
    while regions[cell] != cell:
        regions[cell] = regions[regions[cell]]
        cell = np.int64(regions[cell])
    return cell


@inlined
def _joined(grid, regions, first, neighbour):
    """The first cell of the region of a cell, after joining the region of a neighbour."""
    if grid.cells[neighbour] != FREE:
        return first
    other = _first_of(regions, neighbour)
    low, high = min(first, other), max(first, other)
    regions[high] = low
    return low


@kernel
def _find_regions(grid, regions):
    """Write, for each free cell, the first cell of its region; -1 for others."""
    # In: grid (`OccupancyGrid`). Out: regions (n,) int32
    for cell in range(len(grid.cells)):
        if grid.cells[cell] != FREE:
            regions[cell] = -1
            continue
        x, y, first = cell % grid.nx, cell // grid.nx % grid.ny, cell
        regions[cell] = cell
        if x > 0:
            first = _joined(grid, regions, first, cell - 1)
        if y > 0:
            first = _joined(grid, regions, first, cell - grid.nx)
        if cell >= grid.nx * grid.ny:
            _joined(grid, regions, first, cell - grid.nx * grid.ny)
    for cell in range(len(grid.cells)):
        if regions[cell] >= 0:
            regions[cell] = regions[regions[cell]]  # a first cell is before all others


def regions_of(grid: OccupancyGrid) -> NDArray[np.int32]:
    """(n,) int32: the first cell of each free cell's region, which share faces of cells; -1 for touched cells."""
    regions = np.empty(len(grid.cells), np.int32)
    _find_regions(grid, regions)
    return regions
