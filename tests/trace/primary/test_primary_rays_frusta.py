"""Frusta of a tile: their bounds hold the directions of all their pixels, with rounding."""

import numpy as np
import pytest

import antumbra as at
from antumbra.kernels.jit import kernel
from antumbra.kernels.simd import ptr
from antumbra.query.raster_setup import direction_error
from antumbra.trace.primary.primary_rays import FLOATS, bound_directions


@kernel
def _bound(rays, error, x0, y0, directions):
    bound_directions(rays, error, x0, y0, ptr(directions))


@pytest.mark.parametrize("place", [(0, 0), (32, 16), (96, 48)])
@pytest.mark.parametrize("position", [(0, 0, 4), (3, 2, 1), (1e5, 1e5, -4e4)])
def test_bounds_of_frusta_hold_their_directions(place, position):
    camera = at.Camera(position, (0, 0, 0), width=128, height=64, vfov=50.0)
    rays, (x0, y0), table = camera.rays(np.zeros(3)), place, np.zeros(FLOATS, np.float32)
    _bound(rays, direction_error(rays), x0, y0, table)
    low, high = table.reshape(2, 3, 16)
    y, x = np.mgrid[:16, :32]
    frustum = x // 8 + 4 * (y // 4)
    d = rays.corner + (x0 + x[..., None] + 0.5) * rays.dx + (y0 + y[..., None] + 0.5) * rays.dy
    rounded = d.astype(np.float32)
    for axis in range(3):
        inside = (low[axis][frustum] <= rounded[..., axis]) & (rounded[..., axis] <= high[axis][frustum])
        assert inside.all()
        spread = 7 * abs(rays.dx[axis]) + 3 * abs(rays.dy[axis])
        assert (high[axis] - low[axis] <= 1.001 * spread + 1e-6 * np.abs(d).max()).all(), "the bounds are narrow"
