"""Morton codes order points along a curve on which neighbours are near each other."""

import numpy as np
import pytest

from antumbra.query.query_bounds import morton_codes


def test_codes_interleave_the_bits_of_cells():
    cells = np.random.default_rng(0).integers(0, 1024, (200, 3))
    cells[:2] = [[0, 0, 0], [1023, 1023, 1023]]
    wanted = [
        sum((int(c) >> b & 1) << (3 * b + 2 - k) for k, c in enumerate(cell) for b in range(10)) for cell in cells
    ]
    assert morton_codes(cells.astype(float)).tolist() == wanted
    assert morton_codes(cells.astype(np.float32)).tolist() == wanted


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_any_points_have_codes(dtype):
    assert morton_codes(np.zeros((0, 3), dtype)).shape == (0,)
    assert not morton_codes(np.ones((5, 3), dtype)).any()
    largest = np.finfo(dtype).max
    for far in ([[-largest, 0, 0], [largest, 1, 1]], [[np.finfo(dtype).tiny, 0, 0], [0, 0, 0]]):
        assert morton_codes(np.array(far, dtype)).shape == (2,)
