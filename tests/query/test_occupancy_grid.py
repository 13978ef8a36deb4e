"""Occupancy grids: every cell that a triangle reaches is touched, and regions are those of a flood fill."""

import numpy as np
import pytest

from antumbra.query.occupancy_grid import FREE, TOUCHED, occupancy_grid, regions_of, touch

UNIT = np.float32([[0, 0, 0], [1, 1, 1]])


def cells_of(grid, points):
    """(n,): the cells of float64 points in the box of a grid."""
    steps = np.floor((points - grid.box[0].astype(float)) * grid.scale).astype(int)
    x, y, z = np.clip(steps, 0, np.array([grid.nx, grid.ny, grid.nz]) - 1).T
    return (z * grid.ny + y) * grid.nx + x


def triangles(kind, n, rng):
    corners = rng.uniform(0, 1, (n, 3, 3))
    if kind == "small":
        corners = np.clip(corners[:, :1] + rng.normal(size=(n, 3, 3)) / 50, 0, 1)
    if kind == "slivers":
        corners[:, 2] = (corners[:, 0] + corners[:, 1]) / 2 + rng.normal(size=(n, 3)) * 1e-7
    if kind == "in planes of cells":
        corners = np.round(corners * 4) / 4
        corners[:, :, 0] = corners[:, :1, 0]
    if kind == "points":
        corners[:] = corners[:, :1]
    return np.clip(corners, 0, 1).astype(np.float32)


@pytest.mark.parametrize("kind", ["large", "small", "slivers", "in planes of cells", "points"])
@pytest.mark.parametrize("size, shift", [(1.0, 0.0), (1e-3, 0.05), (300.0, -2e4)])
def test_all_cells_that_triangles_reach_are_touched(kind, size, shift):
    rng = np.random.default_rng(0)
    corners = (triangles(kind, 20, rng) * size + shift).astype(np.float32)
    grid = occupancy_grid((UNIT * size + shift).astype(np.float32), 20)
    assert grid.cells.shape == (grid.nx * grid.ny * grid.nz,) and len(grid.cells) >= 1 << 15
    assert (grid.cells == FREE).all()
    assert touch(grid, corners, 2)
    weights = np.concatenate([rng.dirichlet((1, 1, 1), 4000), np.eye(3), (1 - np.eye(3)) / 2])
    points = (weights[None, :, :, None] * corners[:, None].astype(float)).sum(2).reshape(-1, 3)
    nudge = np.concatenate([np.zeros((1, 3)), rng.uniform(-1, 1, (8, 3)) * 2.0**-12]) * grid.sides
    for each in nudge:
        assert (grid.cells[cells_of(grid, points + each)] == TOUCHED).all()
    assert 0.2 < (grid.cells == FREE).mean() < 1.0


def test_centres_lie_in_their_cells():
    box = np.float32([[-3, 2, 5], [7, 2.5, 9]])
    grid = occupancy_grid(box, 0)
    cells = np.arange(len(grid.cells))
    np.testing.assert_array_equal(cells_of(grid, grid.centres(cells).astype(float)), cells)
    assert grid.nx == grid.ny == grid.nz == 40


def test_a_flat_box_has_a_layer_of_cells_and_a_distant_one_no_grid():
    flat = occupancy_grid(np.float32([[0, 0, 0], [4, 0, 4]]), 100)
    assert flat.ny == 1 and flat.nx == flat.nz == 40 and flat.scale[1] == 0
    assert occupancy_grid(np.float32([[1e6] * 3, [1e6 + 1] * 3]), 100) is None
    assert occupancy_grid(np.zeros((2, 3), np.float32), 0) is None


def test_very_many_large_triangles_are_given_up():
    corners = np.random.default_rng(0).integers(0, 2, (1500, 3, 3)).astype(np.float32)
    corners[:, 0], corners[:, 1] = 0, 1
    assert not touch(occupancy_grid(UNIT, 0), corners, 1)


def flooded(free):
    """Labels of the regions of free cells, (z, y, x) bool, from the lowest cell on; -1 for others."""
    labels = np.where(free, np.arange(free.size).reshape(free.shape), free.size)
    while True:
        padded = np.pad(labels, 1, constant_values=free.size)
        around = [np.roll(padded, step, axis)[1:-1, 1:-1, 1:-1] for axis in range(3) for step in (-1, 1)]
        lower = np.where(free, np.minimum(labels, np.min(around, axis=0)), free.size)
        if (lower == labels).all():
            return np.where(free, labels, -1)
        labels = lower


@pytest.mark.parametrize("density", [0.25, 0.5, 0.75])
def test_regions_are_those_of_a_flood_fill(density):
    grid = occupancy_grid(np.float32([[0, 0, 0], [3, 2, 1]]), 0)
    touched = np.random.default_rng(1).random(len(grid.cells)) < density
    grid.cells[touched] = TOUCHED
    expected = flooded((grid.cells == FREE).reshape(grid.nz, grid.ny, grid.nx)).reshape(-1)
    np.testing.assert_array_equal(regions_of(grid), expected)
    assert len(np.unique(expected)) > 2
