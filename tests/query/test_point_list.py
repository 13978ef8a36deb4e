"""Point lists: shapes, and the frame in which points are rounded."""

import numpy as np
import pytest

import antumbra as at
from antumbra.query.point_list import MAX_COORDINATE, points_of


def test_points_are_recentred_before_they_are_rounded():
    world = np.array([[[5e6 + 0.125, 0.0, -1e-60]], [[5e6, 1.0, 2.0]]])
    arguments = points_of(world, (5e6, 0.0, 0.0))
    local = arguments.local()
    assert arguments.shape == (2, 1) and local.dtype == np.float32 and local.flags.c_contiguous
    assert local.tolist() == [[0.125, 0.0, 0.0], [0.0, 1.0, 2.0]]


def test_points_may_be_of_any_numbers_and_strides():
    points = np.arange(24).reshape(2, 12)[:, ::2].reshape(2, 2, 3)
    assert points_of(points, (0.0, 0.0, 0.0)).local().tolist() == points.reshape(-1, 3).tolist()
    assert points_of(np.zeros((0, 3)), (0.0, 0.0, 0.0)).local().shape == (0, 3)


@pytest.mark.parametrize("wrong", [np.nan, np.inf, -np.inf, MAX_COORDINATE])
def test_the_first_point_that_is_beyond_float32_is_named(wrong):
    points = np.zeros((2, 2, 3))
    points[1, 0, 2] = wrong
    with pytest.raises(at.InputError, match=r"beyond float32 \(point 2\)"):
        points_of(points, (0.0, 0.0, 0.0)).checked()
    others, failed = points_of(points, (0.0, 0.0, 0.0)).without_failed()
    assert failed.tolist() == [2] and not others.local().any()
