"""First and last suns of days: almanacs, closed forms of walls and of the dip of the horizon, and the command."""

from datetime import date
from pathlib import Path

import numpy as np
import pandas
import pytest

import antumbra as at
from antumbra.city.sheets.method_facts import method_facts
from antumbra.city.sheets.sheet import report_pages
from antumbra.city.sun.calendar_diagram import calendar_report
from antumbra.sun.sun_positions import solar_angles

pvlib = pytest.importorskip("pvlib")

HERE = at.Place(52.0, 4.36, timezone="Europe/Amsterdam")
DAYS = [date(2026, 3, 20), date(2026, 6, 21), date(2026, 12, 21)]


def ground(size=400.0):
    return at.Scene.from_arrays([[[-size, -size, 0], [size, -size, 0], [0, size, 0]]], up="z")


def wall(turned=False, distance=20.0, height=8.0):
    """A long wall in the east, or turned by a quarter to the left."""
    corners = np.array(
        [[distance, -1e4, 0], [distance, 1e4, 0], [distance, 1e4, height], [distance, -1e4, height]], float
    )
    if turned:
        corners = corners[:, [1, 0, 2]] * [-1.0, 1.0, 1.0]
    return at.Scene.from_arrays(corners, [[0, 1, 2], [0, 2, 3]], up="z")


def seconds(times):
    return times.astype("datetime64[s]").astype(np.int64)


def test_over_an_open_horizon_the_sun_rises_as_in_almanacs():
    found = at.sun_calendar(ground(), [0.0, 0.0, 1.7], DAYS, place=HERE)
    index = pandas.DatetimeIndex([str(day) for day in DAYS]).tz_localize("Europe/Amsterdam")
    almanac = pvlib.solarposition.sun_rise_set_transit_spa(index, HERE.latitude, HERE.longitude)
    for name, own in (("sunrise", found.first), ("sunset", found.last)):
        expected = almanac[name].dt.tz_localize(None).to_numpy()
        assert np.abs(seconds(own[0]) - seconds(expected)).max() <= 15
    assert np.abs(seconds(found.first) - seconds(found.sunrise)).max() <= 1
    length = (seconds(found.last) - seconds(found.first)) / 3600.0
    assert np.abs(found.hours - length).max() < 0.07


@pytest.mark.parametrize("turned", [False, True])
def test_behind_a_wall_the_sun_appears_where_the_closed_form_says(turned):
    place = HERE._replace(north=-90.0 if turned else 0.0)
    found = at.sun_calendar(wall(turned), [0.0, 0.0, 0.0], DAYS, place=place, sun="centre")
    for k, day in enumerate(DAYS):
        noon = np.datetime64(f"{day}T00:00:00") + np.arange(0, 86400) * np.timedelta64(1, "s")
        elevation, azimuth = (np.radians(angles) for angles in solar_angles(HERE, noon))
        clear = (elevation > 0.0) & ((np.sin(azimuth) <= 0.0) | (np.tan(elevation) > 8.0 / 20.0 * np.sin(azimuth)))
        offset = 7200 if day.month == 6 else 3600
        assert abs(seconds(found.first[0, k]) - offset - seconds(noon[clear.argmax()])) <= 2
        assert found.last[0, k] == found.sunset[0, k] and found.first[0, k] > found.sunrise[0, k]
    assert ((seconds(found.first) - seconds(found.sunrise))[0] > 3000).all()


@pytest.mark.parametrize("k", [0.0, 0.13])
def test_on_a_mountain_the_horizon_dips(k):
    """1,200 m above the plain, the sun rises at an elevation of -sqrt(2 h (1 - k) / R)."""
    point = [0.0, 0.0, 1200.0]
    options = {"place": HERE, "sun": "centre", "curvature": True, "refraction": k}
    found = at.sun_calendar(ground(), point, DAYS, **options)
    dip = np.degrees(np.arctan(np.sqrt(2.0 * 1200.0 * (1.0 - k) / 6_371_000.0)))
    for row in (found.sunrise[0], found.sunset[0], found.first[0]):
        utc = row - np.array([3600, 7200, 3600]) * np.timedelta64(1, "s")
        assert np.abs(solar_angles(HERE, utc)[0] + dip).max() < 0.004
    flat = at.sun_calendar(ground(), point, DAYS, place=HERE, sun="centre")
    assert (seconds(flat.sunrise) - seconds(found.sunrise) > 240).all()


@pytest.mark.parametrize("degrees", [90.0, 180.0, 250.0])
def test_a_window_has_sun_until_it_passes_its_plane_to_the_second(degrees):
    """A window without obstacles that faces an azimuth: the sun is in front of it within 90 degrees of there."""
    facing = np.radians(degrees)
    window = at.point_sensors([[0.0, 0.0, 2.0]], [[np.sin(facing), np.cos(facing), 0.0]])
    found = at.sun_calendar(ground(), window, DAYS, place=HERE, sun="centre", step=4.0)
    for k, day in enumerate(DAYS):
        times = np.datetime64(f"{day}T00:00:00") + np.arange(0, 86400) * np.timedelta64(1, "s")
        elevation, azimuth = (np.radians(angles) for angles in solar_angles(HERE, times))
        sunny = times[(elevation > 0.0) & (np.cos(azimuth - facing) > 0.0)]
        offset = 7200 if day.month == 6 else 3600
        assert abs(seconds(found.first[0, k]) - offset - seconds(sunny[0])) <= 2
        assert abs(seconds(found.last[0, k]) - offset - seconds(sunny[-1])) <= 2
    assert ((found.first > found.sunrise) | (found.last < found.sunset)).any()


def test_a_point_on_the_ground_has_sun_above_its_horizontal_only():
    found = at.sun_calendar(
        ground(), [[0.0, 0.0, 0.0]], DAYS, place=HERE, sun="centre", on_surface=True, curvature=True, step=7.0
    )
    utc = found.first[0] - np.array([3600, 7200, 3600]) * np.timedelta64(1, "s")
    assert np.abs(solar_angles(HERE, utc)[0]).max() < 0.004


def test_days_without_sun_are_empty(tmp_path):
    north = at.Place(75.0, 20.0, timezone="UTC")
    found = at.sun_calendar(ground(), [0.0, 0.0, 2.0], [date(2026, 12, 21), date(2026, 6, 21)], place=north)
    assert np.isnat(found.first[0, 1]) and np.allclose(found.hours[0], [24.0, 0.0])
    found.save(tmp_path / "a.csv")
    rows = (tmp_path / "a.csv").read_text().splitlines()
    assert rows[0] == "point,date,sunrise,first_sun,last_sun,sunset,hours" and rows[2] == "1,2026-12-21,,,,,0"


def test_a_sheet_says_where_the_sun_is_interrupted_and_draws_single_days(tmp_path, monkeypatch):
    text_kind = pytest.importorskip("matplotlib.text").Text
    east, north = 85000.0, 446000.0
    mast = np.array([[-1.5, -9, 0], [1.5, -9, 0], [1.5, -9, 90], [-1.5, -9, 90]]) + (
        east,
        north,
        0,
    )  # before noon's sun
    scene = at.Scene.from_arrays(mast, [[0, 1, 2], [0, 2, 3]], up="z", crs="EPSG:28992")
    found = at.sun_calendar(scene, [east, north, 1.0], "2026-03-01:2026-03-03,2026-05-01", place=HERE)
    report = calendar_report(found, 0)
    facts = dict(report.counts)
    assert facts["days with interrupted sun"].startswith("4") and facts["point"] == "85000.00, 446000.00, 1.00 m"
    assert facts["days"] == "4, 2026-03-01 to 2026-05-01" and facts["days without sun"] == "0 of 4"
    (page,) = report_pages(report, at.Sheet(), whole=False)
    diagram = next(axes for axes in page.figure.axes if axes.get_ylim() == (0.0, 24.0))
    lines = [(line.get_xdata(), line.get_ydata()) for line in diagram.lines]
    assert [len(days) for days, _ in lines] == [4] * 4 + [2] * 4  # no line between days that do not follow each other
    hours = (found.first[0] - found.days).astype("timedelta64[s]").astype(int) / 3600.0
    assert lines[2][1].tolist() == [*hours[:3], hours[2]] and lines[6][1].tolist() == [hours[3]] * 2
    texts = " ".join(text.get_text() for text in page.figure.findobj(text_kind))
    assert "from the first to the last sun" in texts and "EPSG:28992" in texts and "08:00" in texts
    method = dict(method_facts(report.about, report.counts))
    assert method["method"].startswith("Exact rays") and method["sun"] == "the refracted upper limb"
    assert "elevation" not in method and method["eye height"] == "0 m"


@pytest.fixture
def hall(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    Path("wall.obj").write_text("v 20 -900 0\nv 20 900 0\nv 20 900 8\nv 20 -900 8\nv -50 0 0\nf 1 2 3 4\nf 1 2 5\n")
    Path("points.csv").write_text('id,x,y,z\nwest,-5,0,1\n"a, b",10,3,2\n')


WORDS = "calendar", "wall.obj", "--up", "z", "--latitude", "52", "--longitude", "4.36", "--timezone", "Europe/Amsterdam"


def test_the_command_writes_a_table_and_a_plot(cli, hall):
    pytest.importorskip("matplotlib")
    words = *WORDS, "--days", "2026-03-01:2026-03-20", "--step", "10"
    assert cli(*words, "--points", "points.csv", "-o", "a.csv").code == 0
    table = pandas.read_csv("a.csv")
    found = at.sun_calendar(
        at.load("wall.obj", up="z"), [[-5.0, 0, 1], [10.0, 3, 2]], "2026-03-01:2026-03-20", place=HERE, step=10
    )
    assert table["point"].unique().tolist() == ["west", "a, b"] and len(table) == 40
    times = np.array([f"{d}T{t}" for d, t in zip(table["date"], table["first_sun"])], "datetime64[s]")
    assert (times == found.first.ravel()).all() and (table["hours"] > 5.0).all()
    assert cli(*words, "--point", "-5,0,1", "--map", "a.png", "-o", "b.csv").code == 0
    assert Path("a.png").stat().st_size > 20_000 and Path("b.csv").read_text().count("\n") == 21


def test_shards_give_the_same_bytes(cli, hall):
    words = *WORDS, "--days", "2026-03-20", "--step", "20", "--points", "points.csv"
    assert cli(*words, "-o", "whole.csv").code == 0
    for k in range(2):
        assert cli(*words, "-o", "b.csv", "--shard", f"{k}/2").code == 0
    assert not Path("b.csv").exists() and cli("merge", "b.shards").code == 0
    assert Path("b.csv").read_bytes() == Path("whole.csv").read_bytes()


@pytest.mark.parametrize(
    "words, told",
    [
        (("--days", "2026-03-20"), "there are no points"),
        (("--days", "2026-03-20", "--point", "1,2,3", "--points", "points.csv"), "exclude each other"),
        (("--days", "2026-03-40", "--point", "1,2,3"), "is not a day"),
        (("--days", "2026-03-20", "--points", "points.csv", "--map", "a.pdf"), "a diagram shows one point"),
        (
            ("--days", "2026-03-20", "--point", "-5,0,1", "--map", "a.pdf", "--sheet", "scale=1:500"),
            "the sheet is a diagram",
        ),
        (("--days", "2026-03-20", "--point", "900,0,0", "--on-surface"), "where no surface is to place points on"),
    ],
)
def test_errors_leave_no_file(cli, hall, words, told):
    done = cli(*WORDS, *words, "-o", "out.csv")
    assert done.code == 2 and told in done.err and not Path("out.csv").exists(), done
