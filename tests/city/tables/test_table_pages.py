"""Tables of sheets: rows of windows and groups with their names first, otherwise a summary with true statistics."""

import numpy as np
import pytest

import antumbra as at
from antumbra.city.tables.result_table import Column, Table
from antumbra.city.tables.table_pages import MOST_ROWS, tables_of
from result_tables import table
from sheet_cases import site, windows


def test_windows_are_rows_with_their_names_first():
    (made,) = tables_of(windows("us-ft"))
    assert list(made.headers[:5]) == ["id", "dwelling", "x (us-ft)", "y (us-ft)", "z (us-ft)"]
    assert made.title == "Results" and len(made.rows) == 12 and made.keys == 2
    verdict = made.headers.index("en17037 passes")
    assert [row[verdict] for row in made.rows].count("fails") == 3
    assert made.rows[0][:2] == ("A1.1", "A1.1") and made.rows[0][2] == f"{(-30 + 25 / 6) / (1200 / 3937):.2f}"
    assert {made.headers[k] for k in made.right} >= {"x (us-ft)", "sun hours (h)", "energy (kWh/m²)"}


def test_rows_without_names_are_numbered():
    (made,) = tables_of(table("points"))
    assert made.headers[0] == "row" and [row[0] for row in made.rows] == [str(k) for k in range(1, 21)]
    assert made.rows[0][made.headers.index("hours (h)")] == "-" and made.rows[0][made.headers.index("first")] == "-"


def test_buildings_are_rows():
    hours = at.sun_hours(site(), "face", "2026-03-21", place=at.Place(52.0, 4.0), step=240, per="building")
    (made,) = tables_of(hours)
    assert made.headers[0] == "building" and made.rows[0][0] == "River Street"


@pytest.mark.parametrize("kind", ["raster", "points"])
def test_many_rows_and_rasters_are_summarised(kind):
    count = MOST_ROWS + 24
    sensors = at.point_sensors(np.random.default_rng(0).uniform(0, 9, (count, 3)))
    if kind == "raster":
        sensors = at.raster_sensors(site(), 3.75, follow=False)
    count = len(sensors)
    values = np.arange(count, dtype=float)
    values[7] = np.nan
    columns = {"a": Column(values, "us-ft2", "a"), "ok": Column(np.arange(count) % 4 == 0, "", "ok")}
    (made,) = tables_of(Table(sensors, columns))
    rows = {row[0]: dict(zip(made.headers, row)) for row in made.rows}
    known = np.delete(values, 7)
    assert rows["a"]["unit"] == "us-ft²" and rows["a"]["values"] == f"{count - 1:,}" and rows["a"]["least"] == "0"
    assert float(rows["a"]["median"].replace(",", "")) == pytest.approx(np.median(known), rel=1e-3)
    assert float(rows["a"]["95 %"].replace(",", "")) == pytest.approx(np.percentile(known, 95), rel=1e-3)
    assert rows["ok"]["mean"] == "25.0 % yes" and f"{count:,} rows" in made.note


def test_a_column_without_values_is_a_row_of_dashes():
    cells = at.raster_sensors(site(), 30.0)
    (made,) = tables_of(Table(cells, {"a": Column(np.full(len(cells), np.nan), "h", "a")}))
    assert made.rows[0][2:] == ("-", "-", "-", "-", "-", "-", "0")


def test_areas_come_first():
    made = table("raster")
    made.about["areas"] = [
        {"name": "yard", "cells": 0, "left_out": 4, "sun_hours": None, "share": None, "passes": None},
        {"name": "garden", "cells": 9, "left_out": 0, "sun_hours": 2.25, "share": 0.4, "passes": False},
    ]
    areas, summary = tables_of(made)
    assert [row[0] for row in areas.rows] == ["yard", "garden"] and summary.title == "Summary"
    assert areas.rows[0][3:] == ["-", "-", "no cells"] and areas.rows[1][3:] == ["2.25", "40.0 %", "fails"]


def test_areas_have_both_states_beside_each_other():
    made = table("raster")
    garden = {"name": "garden", "cells": 9, "left_out": 0, "sun_hours": 2.25, "sun_hours_before": 4.5}
    made.about["areas"] = [{**garden, "share": 0.4, "share_before": 0.6, "passes": False}]
    areas, _ = tables_of(made)
    assert areas.headers[3:] == [
        "mean sun hours before (h)", "mean sun hours (h)", "share of cells before", "share of cells", "verdict",
    ]  # fmt: skip
    assert areas.rows[0][3:] == ["4.50", "2.25", "60.0 %", "40.0 %", "fails"]
