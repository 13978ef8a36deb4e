import numpy as np
import pytest

from antumbra.query.query_bounds import bounds, reach, triangle_box
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


def test_the_box_of_the_latest_triangles_is_computed_once_and_others_get_their_own():
    rng = np.random.default_rng(2)
    soups = [
        Triangles(rng.normal(size=(50, 3, 3)).astype(np.float32), np.zeros(3), np.arange(50), np.ones((50, 3)))
        for _ in range(2)
    ]
    boxes = [triangle_box(soups[k], 2) for k in (0, 0, 1, 0)]
    assert boxes[0] is boxes[1] and boxes[2] is not boxes[0]
    for k, box in zip((0, 0, 1, 0), boxes):
        np.testing.assert_array_equal(box, np.stack(bounds(soups[k].vertices)))
    moved = soups[0]._replace(vertices=soups[0].vertices + np.float32(1.0))
    np.testing.assert_array_equal(triangle_box(moved), np.stack(bounds(moved.vertices)))
