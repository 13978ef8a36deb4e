"""Map sheets: true legends, classes, smooth rasters whose holes stay, scale, north, facts; the same bytes each time."""

import xml.etree.ElementTree as Xml

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

import antumbra as at
from antumbra.city.tables.map_page import round_length
from antumbra.city.tables.map_scale import map_scale
from antumbra.city.tables.map_sheet import facts_of, map_figure, plan_positions, smooth_cells
from antumbra.city.tables.result_table import Column, Table
from result_tables import hill, table
from strength import examples

pytest.importorskip("matplotlib")

DELFT = at.Place(52.0, 4.36, north=20.0, timezone="Europe/Amsterdam")


def texts(figure):
    """All texts of a sheet, with those of the ticks."""
    there = [each.get_text() for each in figure.texts]
    for axes in figure.axes:
        there += [each.get_text() for each in (*axes.texts, *axes.get_xticklabels())]
    return there


def known(values):
    return np.ones(len(values), bool)


# --- Scales -----------------------------------------------------------------------------------------------------------


@examples(60)
@given(values=hnp.arrays(np.float64, st.integers(1, 30), elements=st.floats(-1e6, 1e6)))
def test_scales_end_at_the_true_extremes(values):
    scale = map_scale(values, known(values), "h")
    assert scale.low == min(values.min(), 0.0) and scale.high == max(values.max(), 0.0)
    ticks = scale.ticks()
    assert ticks[0] == scale.low and ticks[-1] == scale.high and (np.diff(ticks) > 0).all() and len(ticks) <= 10
    stops = scale.stops()
    assert stops[0].value == scale.low and stops[-1].value == scale.high
    ends = scale.colours(np.array([scale.low, scale.high]))
    assert tuple(ends[0]) == stops[0].colour and tuple(ends[1]) == stops[-1].colour


def test_scales_of_classes_whole_numbers_and_nothing():
    classes = map_scale(np.array([True, False]), known([0, 0]))
    assert [(each.value, each.name) for each in classes.classes] == [(0.0, "no"), (1.0, "yes")]
    assert len(set(map(tuple, classes.colours(np.array([0.0, 1.0])).tolist()))) == 2
    whole = map_scale(np.array([0, 3]), known([0, 0]))
    assert whole.whole and whole.ticks() == [0.0, 1.0, 2.0, 3.0]
    outlier = map_scale(np.r_[np.zeros(999), 17.0], known(np.zeros(1000)))
    assert outlier.high == 17.0  # not a percentile
    for nothing in map_scale(np.array([np.nan]), np.zeros(1, bool)), map_scale(np.zeros(4), known(np.zeros(4))):
        assert nothing.ticks() == [0.0] and len(nothing.stops()) == 1 and nothing.colours(np.zeros(2)).shape == (2, 3)
    assert map_scale(np.array([12345.0]), known([0]), "h").text(12345.0) == "12,345 h"


# --- Smooth rasters ---------------------------------------------------------------------------------------------------


@examples(40)
@given(
    cells=hnp.arrays(np.float64, st.tuples(st.integers(1, 6), st.integers(1, 6)), elements=st.floats(-10, 10)),
    holes=st.integers(0, 2**36 - 1),
    parts=st.integers(1, 5),
)
def test_smooth_cells_stay_between_their_neighbours_and_holes_stay(cells, holes, parts):
    cells.ravel()[[k for k in range(cells.size) if holes >> k & 1]] = np.nan
    smooth = smooth_cells(cells, parts)
    assert smooth.shape == (cells.shape[0] * parts, cells.shape[1] * parts)
    assert (np.isnan(smooth) == np.isnan(cells).repeat(parts, 0).repeat(parts, 1)).all()
    if np.isfinite(cells).any():
        inside = smooth[np.isfinite(smooth)]
        assert inside.min() >= np.nanmin(cells) and inside.max() <= np.nanmax(cells)


def test_smooth_cells_have_the_values_of_cells_at_their_centres_and_are_linear():
    cells = np.add.outer(np.arange(4.0), 10.0 * np.arange(5.0))
    smooth = smooth_cells(cells, 3)
    assert np.allclose(smooth[1::3, 1::3], cells)
    assert np.allclose(np.diff(smooth[1:-1], axis=0), 1 / 3) and np.allclose(np.diff(smooth[:, 1:-1], axis=1), 10 / 3)


# --- Sheets -----------------------------------------------------------------------------------------------------------


def test_a_sheet_has_all_its_parts():
    scene = at.Scene.from_arrays([[[0.0, 0, 0], [60, 0, 0], [0, 0, -60]]], name="plot")
    made = at.sun_hours(scene, "raster:10", rule="br209-apsh", sunshine=[60.0] * 12, place=DELFT)
    made.about["crs"], made.about["trees"] = "EPSG:28992", "trees.gpkg"
    figure = map_figure(made, "sun_hours")
    words = texts(figure)
    most = made["sun_hours"].max()
    assert "Hours of direct sun" in words and "sun_hours [h]" in words and "N" in words and "grid" not in words
    assert f"{most:,.0f}" in words and "0" in words and any(word.endswith(" m") for word in words)
    facts = dict(facts_of(made))
    assert facts["scene"] == "plot" and facts["rule"].startswith("br209-apsh: ") and "BR 209" in facts["rule"]
    assert facts["dates"] == "2025-01-01 09:30 to 2025-12-31 16:30" and "52.00000, 4.36000" in facts["place"]
    assert facts["reference system"] == "EPSG:28992" and facts["trees"] == "trees.gpkg"
    assert facts["sensors"] == "36 (raster, cells of 10 m)"
    passes = texts(map_figure(made, "br209_apsh_passes", "My title"))
    assert "My title" in passes
    share = made["br209_apsh_passes"][made.sensors.covered].mean()
    assert f"yes   {share:.1%} of the sensors" in passes and f"no   {1 - share:.1%} of the sensors" in passes
    assert "no value" in passes and not made.sensors.covered.all()


def test_areas_and_observers_are_facts():
    made = table("raster")
    made.about |= {"observers": 3, "areas": [
        {"name": "garden", "sun_hours": 2.5, "share": 0.75, "passes": True}, {"name": "yard", "sun_hours": None},
    ]}  # fmt: skip
    facts = dict(facts_of(made))
    assert facts["area garden"] == "mean 2.5 h; 75.0% of the cells: passes" and facts["area yard"] == "no cells"
    assert facts["observers"] == "3"


@pytest.mark.parametrize("kind", ["face", "vertex", "grid", "raster", "points"])
@pytest.mark.parametrize("column", ["hours", "count"])
def test_all_kinds_of_sensors(kind, column):
    made = table(kind)
    figure = map_figure(made, column)
    words = texts(figure)
    assert "grid" in words and f"{np.nanmax(made[column]):.4g}" in words
    west, east = figure.axes[0].get_xlim()
    assert west <= made.sensors.points[:, 0].min() and east >= made.sensors.points[:, 0].max()


def test_maps_of_y_up_scenes_have_north_up():
    for up in "y", "z":
        scene = hill(up)
        made = Table(at.face_sensors(scene), {"a": Column(np.arange(4.0), "", "a")}, {}, scene, marks=[[1.0, 2.0, 3.0]])
        plan = plan_positions(made, np.array([[1.0, 2.0, 3.0]]))
        assert plan.tolist() == ([[1.0, 2.0]] if up == "z" else [[1.0, -3.0]])
        south, north = map_figure(made, "a").axes[0].get_ylim()
        assert np.allclose([south, north], [-0.3, 10.3])


@given(width=st.floats(1e-3, 1e7))
def test_scale_bars_are_round_and_at_most_a_quarter(width):
    length = round_length(width)
    assert width / 12 < length <= width / 4 * (1 + 1e-9)
    assert float(f"{length:.0e}") == pytest.approx(length) and f"{length:.0e}"[0] in "125"


@pytest.mark.parametrize("unit, cell, bar", [("m", 100.0, "1 km"), ("m", 1.0, "10 m"), ("ft", 100.0, "1000 ft")])
def test_scale_bars_name_the_unit_of_the_scene(unit, cell, bar):
    ground = np.array([[[0.0, 0, 0], [1, 0, 0], [1, 1, 0]], [[0, 0, 0], [1, 1, 0], [0, 1, 0]]]) * 40.0 * cell
    scene = at.Scene.from_arrays(ground, up="z", unit=unit)
    found = texts(map_figure(at.sky_view(scene, f"raster:{cell:g}", directions=4), "sky_view"))
    assert bar in found and any(f"cells of {cell:g} {unit})" in text for text in found)


@pytest.mark.parametrize("suffix", [".pdf", ".svg", ".png"])
def test_the_same_table_gives_the_same_bytes(tmp_path, suffix):
    first, second = tmp_path / f"a{suffix}", tmp_path / f"b{suffix}"
    table("raster").save_map(first)
    table("raster").save_map(second)
    data = first.read_bytes()
    assert data == second.read_bytes() and len(data) > 5000
    table("raster").save_map(second, "count")
    assert second.read_bytes() != data
    if suffix == ".svg":
        assert "Hours of sun" in "".join(Xml.parse(first).getroot().itertext())


def test_faults(tmp_path):
    made = table("raster")
    with pytest.raises(at.InputError, match=r"\.gif"):
        made.save_map(tmp_path / "a.gif")
    with pytest.raises(at.InputError, match="holds times"):
        made.save_map(tmp_path / "a.pdf", "first")
    with pytest.raises(at.InputError, match="give one line of text"):
        made.save_map(tmp_path / "a.pdf", title="a\nb")
    assert not list(tmp_path.iterdir())
