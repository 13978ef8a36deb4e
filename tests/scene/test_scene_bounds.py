"""Bounds of points."""

import numpy as np
import pytest

from antumbra.scene.scene_bounds import bounds_of_points


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
@pytest.mark.parametrize("shape", [(1, 3), (50, 3), (4, 7, 3)])
def test_bounds_of_points(shape, dtype):
    points = np.random.default_rng(0).normal(size=shape).astype(dtype)
    flat = points.reshape(-1, 3)
    bounds = bounds_of_points(points)
    np.testing.assert_array_equal(bounds, [flat.min(0), flat.max(0)])
    assert bounds.dtype == dtype


def test_bounds_with_nan_are_nan_on_that_axis():
    points = np.array([[0.0, 1.0, 2.0], [3.0, np.nan, np.inf]])
    np.testing.assert_array_equal(bounds_of_points(points), [[0, np.nan, 2], [3, np.nan, np.inf]])
