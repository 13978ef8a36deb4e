"""Bands cover a picture. They shrink until their chunks fit in memory, and are given up where none fit."""

import pytest

from antumbra.engine.sources.paged_source import Bands

BUDGET = 1000


def _frame(bands, height, needed, reads):
    """The rows of each band; `reads`: function of rows that returns what camera and shadow rays read."""
    found = []
    for rows in bands.of_frame(height, needed):
        found.append(rows)
        bands.read(*reads(rows), BUDGET)
    assert [rows.start for rows in found] == [0, *(rows.stop for rows in found[:-1])] and found[-1].stop == height
    assert all(rows.start % 16 == 0 for rows in found)
    return [rows.stop - rows.start for rows in found]


def _far(each):
    """Each row reads so much, twice if the band does not fit."""

    def reads(rows):
        looked = each * (rows.stop - rows.start)
        return looked, looked if looked > BUDGET else 0

    return reads


@pytest.mark.parametrize("height", [1, 16, 17, 1080])
def test_one_band_where_memory_suffices(height):
    assert _frame(Bands(), height, False, _far(1e6)) == [height]


@pytest.mark.parametrize("each", [0, 1, 5, 30])
def test_bands_fit(each):
    bands = Bands()
    first = _frame(bands, 1080, True, _far(each))
    assert len(first) > 1
    for _ in range(3):
        again = _frame(bands, 1080, True, _far(each))
        assert again[-1] * each <= BUDGET and (not each or max(again[1:]) * each <= BUDGET)
    assert _frame(bands, 1080, True, _far(each)) == again  # so states of earlier frames serve


def test_bands_are_given_up_where_the_smallest_does_not_fit():
    bands = Bands()
    rows = _frame(bands, 1080, True, _far(1e4))
    assert rows[:2] == [64, 16] and len(rows) == 3
    assert _frame(bands, 1080, True, _far(1e4)) == [1080]
