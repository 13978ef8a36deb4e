"""Texts of numbers in summaries of results."""

import pytest

from antumbra.work.result_summary import duration, heading, speed_text, text_of


@pytest.mark.parametrize(
    "seconds, text",
    [(0.0123, "12.3 ms"), (1.0, "1.00 s"), (59.994, "59.99 s"), (600.0, "10 min"), (6000.0, "1.7 h")],
)
def test_durations_have_a_unit_that_suits_them(seconds, text):
    assert duration(seconds) == text


def test_cells_have_six_digits_and_headers_no_underscores():
    assert [text_of(value) for value in (1234.5678, 7, "a_b")] == ["1,234.57", "7", "a_b"]
    assert heading("sky_view_factor") == "sky view factor"


@pytest.mark.parametrize(
    "rays, seconds, text",
    [(3_400_000, 1.0, ", 3.4 million rays/s"), (999_999, 0.01, ""), (1_000_000, 100.0, ""), (0, 0.0, "")],
)
def test_only_many_rays_have_a_speed(rays, seconds, text):
    assert speed_text(rays, seconds) == text
