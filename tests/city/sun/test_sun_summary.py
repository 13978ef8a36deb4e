"""The summary of sun hours: the same numbers for programs and for people."""

import pytest

import antumbra as at
from antumbra.city.sun.sun_summary import numeric_results, sun_summary

PLACE = at.Place(52.0, 4.36)
DAY = {"place": PLACE, "days": "2026-03-21", "step": 120}


def test_a_summary_has_the_numbers_of_the_table():
    table = at.sun_hours(at.procedural("city", triangles=1000), "raster:20", sky_view=16, **DAY)
    found = sun_summary(table, "sensor", 2.0)
    hours = table["sun_hours"][table.sensors.covered]
    assert found.values["sensors"] == found.values["rows"] == len(table) and found.values["seconds"] == 2.0
    assert found.rays == found.values["rays"] == len(table) * table.about["suns"] * table.about["samples"]
    assert found.values["means"].keys() == set(numeric_results(table)) >= {"sun_hours", "sky_view"}
    assert found.values["means"]["sun_hours"] == hours.mean() > 0.0 and found.table is None
    lines = dict(found.lines)
    assert lines["hours of sun"].startswith(f"{hours.min():,.1f} to {hours.max():,.1f}, median ")
    assert f"{table.about['suns']:,} from" in lines["suns"]


def test_a_summary_has_a_row_for_each_area():
    floor = at.Scene.from_arrays([[-9, -9, 0], [9, -9, 0], [9, 9, 0], [-9, 9, 0]], [[0, 1, 2], [0, 2, 3]], up="z")
    areas = {"lawn": [[0, 0], [4, 0], [4, 4], [0, 4]], "pond": [[-4, -4], [-1, -4], [-1, -1]]}
    table = at.sun_hours(floor, areas=areas, place=PLACE, rule="br209-amenity")
    shown = sun_summary(table, "sensor", 1.0).table
    assert shown is not None and [row[0] for row in shown.rows] == ["lawn", "pond"]
    assert shown.headers[-1] == "passes" and all(row[-1] == "yes" for row in shown.rows)


@pytest.mark.parametrize("per", ["surface"])
def test_rows_of_surfaces_count_their_sensors(per):
    table = at.sun_hours(at.procedural("city", triangles=1000), "face", per=per, **DAY)
    found = sun_summary(table, per, 1.0)
    assert found.values["sensors"] == table["sensors"].sum() > found.values["rows"] == len(table)
    assert (f"{per}s", f"{len(table):,}") in found.lines
