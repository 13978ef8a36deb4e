"""The chart of the papers' values and ours."""

import numpy as np
import pytest
from PIL import Image

from antumbra.lab.papers.comparison_chart import (
    OUR_COLOUR,
    PAPER_COLOUR,
    ComparedValue,
    ComparisonPanel,
    comparison_writer,
    draw_comparison,
    range_of,
)

PANEL = ComparisonPanel(
    "Box tests saved",
    "%",
    (ComparedValue("all scenes", (22, 56), (17, 55)), ComparedValue("BEDROOM", 56, 42), ComparedValue("new", None, 12)),
)


@pytest.fixture
def place():
    """The axes of an empty figure."""
    figure = pytest.importorskip("matplotlib.figure", reason="no matplotlib: charts are NOT tested")
    return figure.Figure().subplots()


def test_ranges():
    assert range_of([]) is None and range_of([3.0]) == 3.0 and range_of(iter([3.0, 1.0, 2.0])) == (1.0, 3.0)


def test_bars_stand_in_pairs(place):
    to_hex = pytest.importorskip("matplotlib.colors").to_hex
    draw_comparison(place, PANEL)
    bars = [(to_hex(b.get_facecolor()), b.get_x(), b.get_width()) for b in place.patches]
    theirs = [(low, width) for colour, low, width in bars if colour == PAPER_COLOUR]
    ours = [(low, width) for colour, low, width in bars if colour == OUR_COLOUR]
    assert theirs == [(22, 34), (0, 56)] and ours == [(17, 38), (0, 42), (0, 12)]
    assert [text.get_text() for text in place.texts] == ["22 to 56", "17 to 55", "56", "42", "12"]
    assert place.get_xlabel() == "%" and len(place.get_yticks()) == 3


def test_values_on_a_logarithmic_axis_are_dots(place):
    draw_comparison(place, PANEL._replace(log=True))
    assert len(place.patches) == 2 and len([line for line in place.lines if line.get_marker() == "o"]) == 3
    assert place.get_xscale() == "log"


@pytest.mark.parametrize("panels", [1, 3])
def test_the_chart_shows_both_colours(tmp_path, panels):
    pytest.importorskip("matplotlib", reason="no matplotlib: charts are NOT tested")
    comparison_writer([PANEL] * panels)(tmp_path / "chart.png")
    colours = {tuple(c) for c in np.asarray(Image.open(tmp_path / "chart.png").convert("RGB")).reshape(-1, 3).tolist()}
    assert {tuple(bytes.fromhex(colour[1:])) for colour in (PAPER_COLOUR, OUR_COLOUR)} <= colours
