import numpy as np
import pytest

from antumbra.query.query_bounds import bounds, reach
from antumbra.scene.triangles import Triangles


@pytest.mark.parametrize("n", [1, 15, 16, 17, 100, 40_000, 150_001])
@pytest.mark.parametrize("threads", [1, 3])
def test_bounds_are_those_of_numpy(n, threads):
    points = np.random.default_rng(n).normal(5.0, 3.0, (n, 3)).astype(np.float32)
    lower, upper = bounds(points, threads)
    np.testing.assert_array_equal(lower, points.min(0))
    np.testing.assert_array_equal(upper, points.max(0))


def test_reach_is_more_than_any_distance():
    rng = np.random.default_rng(1)
    corners, points = (rng.normal(size=(n, 3)).astype(np.float32) for n in (300, 500))
    triangles = Triangles(corners.reshape(-1, 3, 3), np.zeros(3), np.arange(100, dtype=np.int32), np.ones((100, 3)))
    far = np.linalg.norm(corners[:, None].astype(float) - points, axis=-1).max()
    assert far < reach(triangles, points, 2) < 4 * far
