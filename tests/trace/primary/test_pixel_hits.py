"""The state of a tile's pixels: which frusta have pixels, and what counts as in front of nothing."""

import numpy as np
import pytest

import antumbra as at
from antumbra.kernels.jit import kernel
from antumbra.kernels.simd import as_i32, ptr, ptr_at
from antumbra.trace.primary.pixel_hits import NOTHING, start
from antumbra.trace.primary.pixel_tests import CELLS, DEFERRED, PIXELS, Pixels, first_pixel


@kernel
def _start(memory, deferred, x0, y0, rays, corners):
    p = ptr(memory)
    pixels = Pixels(
        p, ptr_at(p, PIXELS), as_i32(ptr_at(p, 2 * PIXELS)), ptr_at(p, 3 * PIXELS), ptr_at(p, 4 * PIXELS),
        as_i32(ptr_at(p, 5 * PIXELS)), as_i32(ptr_at(p, 6 * PIXELS)), ptr(deferred),
    )  # fmt: skip
    for cell in range(CELLS):
        corners[cell, 0], corners[cell, 1] = first_pixel(cell)
    return start(pixels, x0, y0, rays)


@pytest.mark.parametrize("width, height", [(32, 16), (70, 40), (33, 17), (5, 9), (64, 1)])
@pytest.mark.parametrize("x0, y0", [(0, 0), (32, 16), (64, 32)])
def test_pixels_start_without_hits(width, height, x0, y0):
    rays = at.Camera((0, 0, 4), (0, 0, 0), width=width, height=height).rays(np.zeros(3))
    memory, corners = np.full((7, PIXELS), np.nan, np.float32), np.zeros((CELLS, 2), np.int64)
    deferred = np.full(DEFERRED, 7, np.int32)
    alive = _start(memory, deferred, x0, y0, rays, corners)
    lane = np.arange(16)
    x, y = x0 + corners[:, :1] + lane % 4, y0 + corners[:, 1:] + lane // 4
    inside = (x < width) & (y < height)
    np.testing.assert_array_equal(memory[0].reshape(CELLS, 16), np.where(inside, -np.inf, np.inf))
    assert (memory[1] == -np.inf).all() and (memory[2].view(np.int32) == NOTHING).all() and deferred[0] == 0
    np.testing.assert_array_equal(memory[3, :CELLS], np.where(inside.any(1), -np.inf, np.inf))
    np.testing.assert_array_equal(alive >> np.arange(16) & 1 != 0, inside.reshape(2, 16, 16).any((0, 2)))
