"""The scrambled Sobol sequence: the points of scipy, and nets."""

import pytest
from scipy.stats import qmc

from antumbra.query.sobol_sequence import DIMENSIONS, scrambled_sobol


@pytest.mark.parametrize("seed", [0, 1, 2**62])
@pytest.mark.parametrize("dimensions", range(1, DIMENSIONS + 1))
def test_the_points_are_those_of_scipy(dimensions, seed):
    points = scrambled_sobol(512, dimensions, seed)
    assert (points == qmc.Sobol(dimensions, scramble=True, rng=seed).random(512)).all()
    assert (scrambled_sobol(77, dimensions, seed) == points[:77]).all()
    assert not (points == scrambled_sobol(512, dimensions, seed + 1)).all()


def test_each_interval_has_one_point():
    for coordinates in scrambled_sobol(256, DIMENSIONS, 3).T:
        assert sorted((coordinates * 256).astype(int)) == list(range(256))
