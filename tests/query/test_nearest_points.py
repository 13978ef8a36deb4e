"""Nearest points, compared with all distances; ties go to the first point."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from antumbra.query.nearest_points import PointTree


def all_distances(places, points):
    return np.sqrt(sum((places[:, None, k] - points[:, k]) ** 2 for k in range(points.shape[1])))


@given(st.integers(0, 2**32 - 1), st.integers(1, 300), st.integers(1, 6), st.sampled_from([2, 1000]))
def test_nearest_points_are_those_of_brute_force(seed, n, dimensions, grid):
    random = np.random.default_rng(seed)
    points = random.integers(0, grid, (n, dimensions)) / grid  # many ties on a coarse grid
    places = random.integers(-1, 2 * grid, (50, dimensions)) / (2 * grid)
    found, distances = PointTree(points).nearest(places), all_distances(places, points)
    assert (found.indices == distances.argmin(1)).all()
    assert (found.distances == distances.min(1)).all()


@given(st.integers(0, 2**32 - 1), st.integers(1, 300), st.sampled_from([2, 1000]))
def test_nearest_other_points(seed, n, grid):
    points = np.random.default_rng(seed).integers(0, grid, (n, 3)) / grid
    distances = all_distances(points, points)
    np.fill_diagonal(distances, np.inf)
    assert (PointTree(points).nearest(points, others=True).distances == distances.min(1)).all()


@pytest.mark.parametrize("m", [0, 5000])
def test_any_number_of_places(m):
    points = np.random.default_rng(1).normal(size=(2000, 3))
    places = np.random.default_rng(2).normal(size=(m, 3))
    found = PointTree(points).nearest(places)
    assert found.indices.shape == found.distances.shape == (m,)
    assert (found.indices[-9:] == all_distances(places[-9:], points).argmin(1)).all()
