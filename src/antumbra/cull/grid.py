"""The coarse grid of pre-BVH culling [Selgrad et al. 2015, Sec. 3.1], over the part of the scene where rays can be."""

from typing import NamedTuple

import numpy as np

from ..kernels.fields import F32Ptr
from ..kernels.jit import inlined
from ..kernels.simd import extract, get, load4, maximum, minimum, ptr, to_i32

PAD = 2.0**-20  # of the largest coordinate: far more than the errors of float32 samples and of float64 arithmetic


class CellGrid(NamedTuple):
    """A box of n x n x n equal cells.

    One monotone function (`cells_at`) maps a float32 coordinate to its cell, for triangles and for rays alike. Suppose
    a point of a triangle lies between the bounds that were marked for a ray. Then the point's cell is marked too,
    however numbers were rounded.
    """

    bounds: np.ndarray  # (2, 4) float32: lower, upper corner; the fourth number is not used
    scale: np.ndarray  # (4,) float32: cells per unit of length, 0 along an axis without extent
    n: int  # cells along an axis


class GridPointers(NamedTuple):
    """Pointers to the arrays of a `CellGrid`. The arrays must outlive them. Kernels take either type."""

    bounds: F32Ptr  # float32 *
    scale: F32Ptr  # float32 *
    n: int


@inlined
def pointers_of(grid):
    """The `GridPointers` of a `CellGrid`."""
    return GridPointers(ptr(grid.bounds), ptr(grid.scale), np.int64(grid.n))


def grid_over(lower, upper, n: int) -> CellGrid:
    """The `CellGrid` over the box from `lower` to `upper`, (3,) float64 each, rounded outwards."""
    bounds = np.zeros((2, 4), np.float32)
    bounds[0, :3] = np.nextafter(np.asarray(lower, np.float32), np.float32(-np.inf))
    bounds[1, :3] = np.nextafter(np.asarray(upper, np.float32), np.float32(np.inf))
    extent = bounds[1].astype(np.float64) - bounds[0]
    scale = np.divide(n, extent, out=np.zeros(4), where=extent > n * np.finfo(np.float32).tiny)
    return CellGrid(bounds, scale.astype(np.float32), n)


@inlined
def cells_at(grid, point):
    """The cells (i32x4, one for each axis) of an f32x4 of coordinates, clamped to the grid."""
    place = (point - load4(grid.bounds, 0)) * load4(grid.scale, 0)
    return to_i32(minimum(maximum(place, np.float32(0.0)), np.float32(grid.n - 1)))


@inlined
def cell_at(grid, axis, x):
    """The cell of one float32 coordinate along an axis: the same number as from `cells_at`."""
    place = (x - get(grid.bounds, axis)) * get(grid.scale, axis)
    return np.int64(min(max(place, np.float32(0.0)), np.float32(grid.n - 1)))


@inlined
def cell_number(grid, cell):
    """The number of a cell given as an i32x4: (x n + y) n + z."""
    n = np.int64(grid.n)
    return (np.int64(extract(cell, 0)) * n + np.int64(extract(cell, 1))) * n + np.int64(extract(cell, 2))
