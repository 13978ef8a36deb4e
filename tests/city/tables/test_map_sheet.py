"""Map sheets: true legends, classes, smooth rasters whose holes stay, scale, north, facts; the same bytes each time."""

import xml.etree.ElementTree as Xml

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

import antumbra as at
from antumbra.city.sheets.map_frame import Extent, round_length
from antumbra.city.tables.map_legend import facts_of, mark_facts, scale_of
from antumbra.city.tables.map_scale import map_scale
from antumbra.city.tables.map_sheet import cells_in
from antumbra.city.tables.result_table import Column, Table
from result_tables import hill, table
from sheet_pages import table_map, texts
from strength import examples

pytest.importorskip("matplotlib")

DELFT = at.Place(52.0, 4.36, north=20.0, timezone="Europe/Amsterdam")


def known(values):
    return np.ones(len(values), bool)


# --- Scales -----------------------------------------------------------------------------------------------------------


@example(values=np.array([5e-324]))
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
    for name in "passes", "vsc_passes", "vsc_passes_before":
        verdicts = map_scale(np.array([True, False]), known([0, 0]), name=name)
        assert [each.name for each in verdicts.classes] == ["fails", "passes"] and verdicts.class_type == "bool"
    whole = map_scale(np.array([0, 3]), known([0, 0]))
    assert whole.whole and whole.ticks() == [0.0, 1.0, 2.0, 3.0]
    outlier = map_scale(np.r_[np.zeros(999), 17.0], known(np.zeros(1000)))
    assert outlier.high == 17.0  # not a percentile
    for nothing in map_scale(np.array([np.nan]), np.zeros(1, bool)), map_scale(np.zeros(4), known(np.zeros(4))):
        assert nothing.ticks() == [0.0] and len(nothing.stops()) == 1 and nothing.colours(np.zeros(2)).shape == (2, 3)
    assert map_scale(np.array([12345.0]), known([0]), "h").text(12345.0) == "12,345 h"


# --- Cells of maps ----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "cells, bounds", [((7, 9), (0, 0, 9, 7)), ((7, 9), (2.5, 1.5, 6.2, 4.0)), ((6500, 40), (0, 0, 40, 6500))]
)
def test_cells_of_a_map_lie_where_they_are(cells, bounds):
    rows, columns = cells
    raster = at.Raster(100.0, 200.0, 2.0, columns, rows)
    values = np.add.outer(1000.0 * np.arange(rows), np.arange(columns))
    west, south, east, north = bounds
    wanted = Extent(100.0 + 2 * west, 200.0 - 2 * north, 100.0 + 2 * east, 200.0 - 2 * south)
    some, extent = cells_in(values, raster, wanted)
    assert max(some.shape) <= 3000 and extent.width / some.shape[1] == extent.height / some.shape[0]
    side, (row, column) = extent.width / some.shape[1], np.indices(some.shape)
    at_centre = np.stack([extent.west + (column + 0.5) * side, extent.north - (row + 0.5) * side])
    inside = np.floor((200.0 - at_centre[1]) / 2.0) * 1000.0 + np.floor((at_centre[0] - 100.0) / 2.0)
    assert (some == inside).all()
    assert extent.west <= wanted.west and extent.north >= wanted.north and extent.east > wanted.east - side
    assert cells_in(values, raster, Extent(0.0, 0.0, 50.0, 50.0))[0].size == 0


# --- Sheets -----------------------------------------------------------------------------------------------------------


def test_a_sheet_has_all_its_parts():
    scene = at.Scene.from_arrays([[[0.0, 0, 0], [60, 0, 0], [0, 0, -60]]], name="plot")
    made = at.sun_hours(scene, "raster:10", rule="br209-apsh", sunshine=[60.0] * 12, place=DELFT)
    made.about["crs"], made.about["trees"] = "EPSG:28992", "trees.gpkg"
    figure = table_map(made, "sun_hours")
    words = texts(figure)
    most = made["sun_hours"].max()
    assert "Hours of direct sun" in words and "sun_hours [h]" in words and "N" in words and "grid" not in words
    assert f"{most:,.0f}" in words and "0" in words and any(word.endswith(" m") for word in words)
    facts = dict(facts_of(made))
    assert facts["scene"] == "plot" and "BR 209" in facts["rule br209-apsh"]
    assert facts["dates"] == "2025-01-01 09:30 to 2025-12-31 16:30" and "52.00000, 4.36000" in facts["place"]
    assert facts["reference system"] == "EPSG:28992, Amersfoort / RD New" and facts["trees"] == "trees.gpkg"
    assert facts["sensors"] == "36 (raster, cells of 10 m)"
    passes = texts(table_map(made, "br209_apsh_passes", title="My title"))
    assert "My title" in passes
    share = made["br209_apsh_passes"][made.sensors.covered].mean()
    passes = " ".join(passes)
    assert (
        f"passes: {100 * share:.1f} % of the cells" in passes
        and f"fails: {100 - 100 * share:.1f} % of the cells" in passes
    )
    assert "no value" in passes and not made.sensors.covered.all()


def test_areas_and_observers_are_facts():
    made = table("raster")
    made.about |= {"observers": 3, "areas": [
        {"name": "garden", "sun_hours": 2.5, "share": 0.75, "passes": True}, {"name": "yard", "sun_hours": None},
    ]}  # fmt: skip
    facts = dict(facts_of(made))
    assert facts["area garden"] == "mean 2.5 h; 75.0 % of the cells: passes" and facts["area yard"] == "no cells"
    assert facts["observers"] == "3"


def test_turbines_have_the_labels_of_their_columns():
    scene = hill("z")
    x, y = scene.bounds[:, :2].mean(0)
    one, two = (at.Turbine((x, y + north, 0.0), hub_height=60.0, rotor_diameter=30.0) for north in (-3.0, 3.0))
    for farm in ({"WT north": one, "WT 2": two}, [one, two]):
        made = at.visible_share(scene, "raster:2+1.6", farm, on_surface=True)
        words, names = texts(table_map(made, "turbines")), made.about["targets"]
        assert [f"share_{name}" for name in names] == list(made.columns)[3:] and set(names) <= set(words)
        assert "turbines" in words and [name for name, _ in mark_facts(made)] == [f"turbine {name}" for name in names]


def test_areas_say_what_they_were_before():
    made = table("raster")
    areas = {
        "name": "garden",
        "sun_hours": 2.5,
        "sun_hours_before": 4.0,
        "share": 0.7,
        "share_before": 0.9,
        "passes": True,
    }
    made.about["areas"] = [areas]
    text = "mean 2.5 h (before: 4.0 h); 70.0 % of the cells (before: 90.0 %): passes"
    assert dict(facts_of(made))["area garden"] == text


def test_each_rule_and_each_change_is_a_fact_and_rows_are_named():
    made = table("points")
    rules = [{"name": name, "citation": f"clause of {name}", "text": "t", "notes": "n"} for name in ("a", "b")]
    made.about |= {"rules": rules, "change": ["added tower", "removed house"], "per": "dwelling", "lowest": 11.0}
    made.about |= {"first": "2026-03-21T08", "last": "2026-03-21T17", "suns": 9, "hours": 9.0}
    facts = list(facts_of(made))
    assert ("rule a", "clause of a") in facts and ("rule b", "clause of b") in facts
    assert [text for name, text in facts if name == "change"] == ["added tower", "removed house"]
    assert ("sun", "9 positions, 9 h above 11 degrees") in facts and ("dwellings", f"{len(made):,}") in facts
    made.columns["q_passes"] = at.Column(np.arange(len(made)) % 2 == 0, "", "verdict by q")
    words = texts(table_map(made, "q_passes"))
    assert "Verdict by q, per dwelling" in words
    assert any(word.startswith("passes: ") and word.endswith("of the dwellings") for word in words)


@pytest.mark.parametrize("kind", ["face", "vertex", "grid", "raster", "points"])
@pytest.mark.parametrize("column", ["hours", "count"])
def test_all_kinds_of_sensors(kind, column):
    made = table(kind)
    figure = table_map(made, column)
    found = texts(figure)
    most = f"{np.nanmax(made[column]):.4g}"
    assert "grid" in found and any(text == most or text.startswith(f"{most}: ") for text in found)
    west, east = figure.axes[0].get_xlim()
    shown = made.sensors.points[made.sensors.covered, 0]
    assert west <= shown.min() and east >= shown.max()


def test_walls_alone_are_lines_in_the_colours_of_their_values_and_failing_ones_lie_on_top():
    corners, faces = np.array(list(np.ndindex(2, 2, 2)), float) * (20.0, 10.0, 6.0), []
    for a, b, c, d in [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]:
        faces += [(a, b, c), (a, c, d)]
    scene = at.Scene.from_arrays(corners, faces, up="z", name="block")
    keywords = {"days": "2026-03-21", "place": DELFT, "per": "facade"}
    walls = at.sun_hours(scene, "face", surfaces=["WallSurface"], **keywords)
    walls.columns["q_passes"] = at.Column(walls["sun_hours"] > 3.0, "", "verdict by q")
    assert 0 < walls["q_passes"].sum() < len(walls) == 4
    axes, classes = table_map(walls, "q_passes").axes[0], scale_of(walls, "q_passes")
    (lines,) = (each for each in axes.collections if each.get_linewidth()[0] == 2.0)
    drawn = np.round(lines.get_color()[:, :3] * 255).tolist()
    passing = np.repeat(np.sort(walls["q_passes"])[::-1], 2).astype(float)  # two triangles each
    assert drawn == classes.colours(passing).tolist() and len(lines.get_segments()) == 8
    all_faces = at.sun_hours(scene, "face", **{**keywords, "per": "building"})
    outlined = table_map(all_faces, "sun_hours").axes[0].collections
    assert all(each.get_linewidth()[0] < 2.0 for each in outlined if type(each).__name__ == "LineCollection")


@pytest.mark.parametrize("up", ["y", "z"])
def test_maps_of_y_up_scenes_have_north_up(up):
    scene = hill(up)
    made = Table(at.face_sensors(scene), {"a": Column(np.arange(4.0), "", "a")}, {}, scene, marks=[[1.0, 2.0, 3.0]])
    axes = table_map(made, "a").axes[0]
    mark = next(each for each in axes.collections if type(each).__name__ == "PathCollection")
    assert mark.get_offsets().tolist() == ([[1.0, 2.0]] if up == "z" else [[1.0, -3.0]])
    south, north = axes.get_ylim()
    low = 0.0 if up == "z" else -3.0  # the mark lies beside the hill
    assert south < low and north > 10.0 and (south + north) / 2 == pytest.approx((low + 10.0) / 2)


@given(width=st.floats(1e-3, 1e7))
def test_scale_bars_are_round_and_at_most_a_quarter(width):
    length = round_length(width)
    assert width / 12 < length <= width / 4 * (1 + 1e-9)
    assert float(f"{length:.0e}") == pytest.approx(length) and f"{length:.0e}"[0] in "125"


@pytest.mark.parametrize("unit, cell, bar", [("m", 100.0, "1 km"), ("m", 1.0, "10 m"), ("ft", 100.0, "1000 ft")])
def test_scale_bars_name_the_unit_of_the_scene(unit, cell, bar):
    ground = np.array([[[0.0, 0, 0], [1, 0, 0], [1, 1, 0]], [[0, 0, 0], [1, 1, 0], [0, 1, 0]]]) * 40.0 * cell
    scene = at.Scene.from_arrays(ground, up="z", unit=unit)
    found = texts(table_map(at.sky_view(scene, f"raster:{cell:g}", directions=4), "sky_view"))
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
