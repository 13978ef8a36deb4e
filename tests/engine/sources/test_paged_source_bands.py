"""Bands cover a picture, down and up in turn. They shrink until their chunks fit, and are given up where none fit."""

import pytest

from antumbra.engine.sources.paged_source import Bands

BUDGET = 1000


def _frame(bands, height, each, exceeds=True, free=0):
    """The bands of a frame, from top to bottom; `each`: bytes of the chunks that a row uses.

    Where the chunks of a band do not fit in memory, they come twice.
    """
    found = []
    for rows in bands.of_frame(height, exceeds):
        found.append(rows)
        used = each * (rows.stop - rows.start)
        bands.traced(used, used if used > BUDGET else 0, BUDGET)
    bands.end_frame(each * height, free, BUDGET)
    if found[0].start > 0:
        found.reverse()
    assert [rows.start for rows in found] == [0, *(rows.stop for rows in found[:-1])] and found[-1].stop == height
    assert all(rows.start % 32 == 0 for rows in found)
    return found


def _rows(found):
    return [rows.stop - rows.start for rows in found]


@pytest.mark.parametrize("height", [1, 16, 17, 1080])
def test_one_band_where_memory_suffices(height):
    assert _rows(_frame(Bands(), height, 1e6, exceeds=False)) == [height]


@pytest.mark.parametrize("each", [1, 5, 10, 30])
def test_bands_fit(each):
    bands = Bands()
    assert len(_frame(bands, 1080, each)) > 1
    for _ in range(4):
        again = _frame(bands, 1080, each)
    assert len(again) > 1 and max(_rows(again)) * each <= BUDGET
    for _ in range(3):  # down and up, so that states of earlier frames serve
        assert _frame(bands, 1080, each) == again


def test_frames_go_down_and_up_in_turn():
    bands, starts = Bands(), []
    for _ in range(3):
        starts.append([])
        for rows in bands.of_frame(600, True):
            starts[-1].append(rows.start)
            bands.traced(0, 0, BUDGET)
        bands.end_frame(BUDGET, 0, BUDGET)
    assert len(starts[0]) > 2 and starts[0] == sorted(starts[0]) == starts[1][::-1] == starts[2]


@pytest.mark.parametrize("each, free", [(5, BUDGET), (0, 0)], ids=["memory is left", "nothing is new"])
def test_the_next_frame_has_one_band_if_the_chunks_fit(each, free):
    """And it has bands again once chunks come twice."""
    bands = Bands()
    assert len(_frame(bands, 1080, each, free=free)) > 1
    assert _rows(_frame(bands, 1080, 0)) == [1080]
    assert _rows(_frame(bands, 1080, 5)) == [1080]
    assert len(_frame(bands, 1080, 5)) > 1


def test_bands_of_pictures_of_another_size_are_chosen_anew():
    bands = Bands()
    for height in (300, 1080, 40, 300, 301):
        _frame(bands, height, 5)


def test_bands_are_given_up_where_the_smallest_does_not_fit():
    bands = Bands()
    rows = _rows(_frame(bands, 1080, 1e4))
    assert rows[:2] == [64, 32] and len(rows) == 3
    assert _rows(_frame(bands, 1080, 1e4)) == [1080]
