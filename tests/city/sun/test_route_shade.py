"""Shade along a route: closed forms of a wall, the share of the route, files in any CRS, and errors."""

import json
from datetime import date
from pathlib import Path

import numpy as np
import pandas
import pytest

import antumbra as at
from antumbra.sun.sun_positions import suns_of, times_of, zone_of
from city.sun.test_sun_calendar import wall

geopandas = pytest.importorskip("geopandas")

HERE = at.Place(52.0, 4.36, timezone="Europe/Amsterdam")
DAY = date(2026, 6, 21)


@pytest.mark.parametrize("turned", [False, True])
def test_the_shade_of_a_wall_has_its_closed_form(turned):
    """A walk away from a wall of 8 m in the east: it shades what lies nearer than 8 m sin(azimuth) / tan(elevation)."""
    line, place = np.array([(19.5, 0.0, 0.0), (-20.5, 0.0, 0.0)]), HERE._replace(north=-90.0 if turned else 0.0)
    if turned:
        line = line[:, [1, 0, 2]] * [-1.0, 1.0, 1.0]
    found = at.route_shade(wall(turned), line, 1.0, "2026-06-21", place=place, step=10)
    suns = suns_of(HERE, times_of([DAY], zone_of(HERE), 10.0), "z")
    reach = 8.0 * np.sin(np.radians(suns.azimuth)) / np.tan(np.radians(suns.altitude))  # of the shadow, to the west
    away = 20.0 - (19.0 - np.arange(40.0))  # of the stations from the wall
    dark = reach > away[:, None]
    hour = suns.local.astype("datetime64[h]").astype(np.int64) % 24
    assert found.hours.tolist() == sorted(set(hour.tolist())) and len(found.table) == 40
    for k, each in enumerate(found.hours.tolist()):
        expected = dark[:, hour == each].mean(1)
        assert np.abs(found.table[f"shade_{each:02d}"] - expected).max() < 1e-9
        assert found.shade[k] == pytest.approx(expected.mean(), abs=1e-9)
    assert np.allclose(found.table["shade"], dark.mean(1)) and np.allclose(found.table["distance"], np.arange(40) + 0.5)
    assert found.shade[0] == 1.0 and 0.0 < found.shade[3] < 1.0 and found.shade[-1] == 0.0


@pytest.fixture
def town(tmp_path, monkeypatch):
    """Two houses and a walk between them, in the Dutch national grid."""
    from shapely.geometry import LineString, box

    monkeypatch.chdir(tmp_path)
    houses = [box(85000, 447000, 85010, 447010), box(85020, 447000, 85030, 447030)]
    geopandas.GeoDataFrame({"height": [9.0, 12.0]}, geometry=houses, crs="EPSG:28992").to_file("town.gpkg")
    walk = geopandas.GeoDataFrame(geometry=[LineString([(85015, 446980), (85015, 447040)])], crs="EPSG:28992")
    walk.to_file("walk.gpkg")
    walk.to_crs("EPSG:4326").to_file("walk.geojson")
    Path("walk.csv").write_text("x,y\n85015,446980\n85015,447040\n")
    return at.from_footprints("town.gpkg")


@pytest.mark.parametrize("name", ["walk.gpkg", "walk.geojson", "walk.csv"])
def test_the_command_writes_stations_by_hours(cli, town, name):
    words = "--line", name, "--spacing", "2.01", "--eye-height", "1.2", "--days", "2026-09-21", "--hours", "hours.csv"
    assert cli("route", "town.gpkg", *words, "-o", "a.csv").code == 0
    expected = at.route_shade(town, [(85015.0, 446980.0), (85015.0, 447040.0)], 2.01, "2026-09-21", eye_height=1.2)
    table, hours = pandas.read_csv("a.csv"), pandas.read_csv("hours.csv")
    assert len(table) == 30 and np.allclose(table["distance"], np.arange(30) * 2.0 + 1.0, atol=1e-3)
    for column in expected.table.columns:
        assert np.abs(table[column] - expected.table[column]).mean() < 0.003
    assert np.abs(hours["shade"] - expected.shade).max() < 0.003 and 0.1 < hours["shade"].mean() < 0.9
    assert hours["hour"].tolist() == expected.hours.tolist()


def test_shards_give_the_same_bytes(cli, town):
    words = "route", "town.gpkg", "--line", "walk.csv", "--spacing", "5", "--eye-height", "1", "--days", "2026-09-21"
    assert cli(*words, "-o", "whole.csv").code == 0
    for k in range(2):
        assert cli(*words, "-o", "b.csv", "--shard", f"{k}/2").code == 0
    assert not Path("b.csv").exists() and cli("merge", "b.shards").code == 0
    assert Path("b.csv").read_bytes() == Path("whole.csv").read_bytes()


@pytest.mark.parametrize(
    "words, told",
    [
        (("--line", "none.gpkg", "--spacing", "2", "--days", "2026-09-21"), "none.gpkg"),
        (("--line", "town.gpkg", "--spacing", "2", "--days", "2026-09-21"), "has no lines"),
        (("--line", "walk.csv", "--spacing", "0", "--days", "2026-09-21"), "--spacing"),
        (("--line", "walk.csv", "--spacing", "2", "--days", "soon"), "is not a day"),
        (("--line", "walk.csv", "--spacing", "2", "--days", "2026-09-21", "--on-surface"), "lie beside town"),
    ],
)
def test_errors_leave_no_file(cli, town, words, told):
    done = cli("route", "town.gpkg", *words, "-o", "out.csv")
    assert done.code == 2 and told in done.err and not Path("out.csv").exists(), done


def test_degrees_need_the_crs_of_the_scene(town):
    document = json.loads(Path("walk.geojson").read_text())
    Path("here.geojson").write_text(json.dumps(document))
    with pytest.raises(at.InputError, match=r"here\.geojson: is in degrees, and the scene has no CRS"):
        at.route_shade(wall(), "here.geojson", 2.0, "2026-09-21", place=HERE)


def test_stations_on_the_surface_are_not_in_its_own_shade():
    """On an open slope, the surface itself hides nothing from stations that lie on it."""
    corners = [[0.0, 0, 1.1], [90, 0, 7.3], [90, 90, 3.7], [0, 90, 0.3]]
    slope = at.Scene.from_arrays(corners, [[0, 1, 2], [0, 2, 3]], up="z")
    found = at.route_shade(slope, [(3.0, 7.0), (83.0, 71.0)], 1.0, "2026-06-21", place=HERE, on_surface=True)
    assert "warnings" not in found.table.about and found.shade[2:-2].max() == 0.0
