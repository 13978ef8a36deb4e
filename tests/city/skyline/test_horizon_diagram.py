"""Diagrams of skylines: bars of closed forms, paths of the sun and facts; the same bytes each time."""

from datetime import date

import numpy as np
import pytest

import antumbra as at
from antumbra.city.sheets.sun_paths import sun_path
from antumbra.city.skyline.horizon_diagram import horizon_facts, horizon_report
from sheet_pages import map_of, texts

pytest.importorskip("matplotlib")

DELFT = at.Place(52.0, 4.36, timezone="Europe/Amsterdam")


def wall():
    """A wall of height 10 along the parallel 10 north of the origin, very long."""
    return at.Scene.from_arrays(
        [[[-1e5, 10, 0], [1e5, 10, 0], [1e5, 10, 10]], [[-1e5, 10, 0], [1e5, 10, 10], [-1e5, 10, 10]]], up="z"
    )


def test_a_diagram_has_the_elevations_as_bars():
    skyline = at.skyline(wall(), [[0.0, 0, 0], [0, 9, 0]], azimuth_step=45.0)
    figure = map_of(horizon_report(skyline, 0, None), title="To the north")
    bars = [patch for patch in figure.axes[0].patches]
    assert len(bars) == 16
    along = np.array([bar.get_height() for bar in bars[8:]])
    assert along == pytest.approx(np.maximum(skyline.elevation[0], 0.0))
    assert along[[0, 1, 7]] == pytest.approx(
        [45, np.degrees(np.arctan(np.sqrt(0.5))), np.degrees(np.arctan(np.sqrt(0.5)))]
    )
    assert along[2:7] == pytest.approx(np.zeros(5), abs=0.1)
    assert [bar.get_y() + bar.get_height() for bar in bars] == pytest.approx([90] * 16)
    assert np.array([bar.get_x() + bar.get_width() / 2 for bar in bars[:8]]) == pytest.approx(
        np.radians(skyline.azimuth)
    )
    assert "To the north" in texts(figure) and not any("sun on" in word for word in texts(figure))
    facts = dict(horizon_facts(skyline, 0, None))
    assert facts["highest"] == "45.00 degrees, towards 0" and facts["point"] == "0, 0, 0"
    assert "sun on 21 June" in texts(map_of(horizon_report(skyline, 1, DELFT)))


def test_paths_of_the_sun():
    noon = {}
    for day in date(2026, 6, 21), date(2026, 3, 20), date(2026, 12, 21):
        azimuth, elevation = sun_path(DELFT, day).T
        k = elevation.argmax()
        noon[day.month] = elevation[k]
        assert azimuth[k] == pytest.approx(180, abs=1) and (np.diff(azimuth) > 0).all() and elevation.min() >= 0
        assert azimuth[0] + azimuth[-1] == pytest.approx(360, abs=2)
    assert noon == pytest.approx({6: 90 - 52 + 23.44, 3: 90 - 52, 12: 90 - 52 - 23.44}, abs=0.3)
    assert len(sun_path(at.Place(80.0, 0.0), date(2026, 12, 21))) == 0
    assert len(sun_path(at.Place(80.0, 0.0), date(2026, 6, 21))) == 721


def test_a_crs_gives_the_paths(tmp_path):
    scene = at.Scene.from_arrays(
        np.array([[[85000.0, 447000, 0], [85010, 447000, 0], [85000, 447010, 5]]]), up="z", crs="EPSG:28992"
    )
    skyline = at.skyline(scene, [[85002.0, 446990, 1]], azimuth_step=30.0)
    skyline.save_map(tmp_path / "a.svg")
    text = (tmp_path / "a.svg").read_text()
    assert "sun on 21 December" in text and "52.0" in text and "EPSG:28992" in text
    with pytest.raises(at.InputError, match=r"a\.pdf: a diagram shows one point, and there are 2; name a point"):
        at.skyline(scene, [[85002.0, 446990, 1]] * 2, azimuth_step=30.0).save_map(tmp_path / "a.pdf")
    with pytest.raises(at.InputError, match="point"):
        skyline.save_map(tmp_path / "a.pdf", point=1)


@pytest.mark.parametrize("suffix", [".pdf", ".svg", ".png"])
def test_the_same_skyline_gives_the_same_bytes(tmp_path, suffix):
    first, second = tmp_path / f"a{suffix}", tmp_path / f"b{suffix}"
    skyline = at.skyline(wall(), [[0.0, 0, 0]], azimuth_step=10.0)
    skyline.save_map(first, place=DELFT)
    skyline.save_map(second, place=DELFT)
    assert first.read_bytes() == second.read_bytes() and len(first.read_bytes()) > 5000
    skyline.save_map(second)
    assert first.read_bytes() != second.read_bytes()
