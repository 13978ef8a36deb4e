"""`antumbra shadow`."""

import numpy as np
import pytest

import antumbra as at
import city_files

pytest.importorskip("shapely", reason="shadows need antumbra[gis]: NOT checked")
geopandas = pytest.importorskip("geopandas", reason="shadows need antumbra[gis]: NOT checked")

SCENE = "procedural:city?triangles=3000"
HERE = "--latitude", 52, "--longitude", 4.36, "--timezone", "Europe/Amsterdam"
MOMENT = "--at", "2026-06-21T15:00"


def test_files_and_answers_are_those_of_the_function(cli):
    told = cli("shadow", SCENE, *HERE, *MOMENT, "--plane", 0, "-o", "a.gpkg", "-o", "a.geojson", "--json").json()
    place = at.Place(52, 4.36, timezone="Europe/Amsterdam")
    want = at.shadow(at.procedural("city", triangles=3000), at="2026-06-21T15:00", place=place, plane=0.0)
    assert told["files"] == ["a.gpkg", "a.geojson"] and told["polygons"] == len(want.polygons) > 1
    assert told["area"] == pytest.approx(want.area) and told["sun_elevation"] == want.about["sun_elevation"]
    assert geopandas.read_file("a.gpkg").area.sum() == pytest.approx(want.area)
    shown = cli("shadow", SCENE, *HERE, *MOMENT, "--plane", 0, "-o", "b.parquet")
    assert shown.code == 0 and "elevation" in shown.out and "polygons" in shown.out


def test_hours_in_classes(cli):
    days = "--days", "2026-03-21", "--step", 60, "--cell", 8, "--classes", "0,2,4"
    told = cli("shadow", SCENE, *HERE, *days, "-o", "a.gpkg", "-o", "a.tif", "--json").json()
    assert told["rows"]["hours_from"] == [0.0, 2.0, 4.0] and sum(told["rows"]["area"]) == told["area"]
    assert told["days"] == "2026-03-21"
    shown = cli("shadow", SCENE, *HERE, *days, "-o", "b.gpkg")
    assert "h of daylight" in shown.out and "hours from" in shown.out


def test_a_city_knows_its_place_and_its_buildings(cli, tmp_path):
    cubes = city_files.city(vertices=city_files.CUBE + (85000, 447000, 0))
    path = city_files.put(tmp_path, cubes)
    told = cli("shadow", path, *MOMENT, "--per", "object", "--json").json()
    assert told["files"] == ["a-shadow.gpkg"] and told["rows"]["object"] == ["a"] and told["crs"] == "EPSG:7415"
    frame = geopandas.read_file(tmp_path / "a-shadow.gpkg")
    assert frame.crs.to_epsg() == 28992 and frame["object"].tolist() == ["a"]
    assert np.isclose(frame.area.sum(), told["area"])


@pytest.mark.parametrize(
    "arguments, words",
    [
        (HERE, ("give either --at TIME", "--days DAYS")),
        ((*HERE, *MOMENT, "--days", "2026-06-21"), ("give either --at TIME",)),
        (MOMENT, ("the place is unknown; give --latitude and --longitude, or --crs",)),
        ((*HERE, "--at", "2026-06-21T01:00"), ("degrees below the horizon",)),
        ((*HERE, "--at", "today"), ("--at", "2026-06-21T15:00")),
        ((*HERE, *MOMENT, "-o", "a.tif"), ("needs cells",)),
        ((*HERE, *MOMENT, "-o", "a.shp"), (".shp", ".gpkg")),
        ((*HERE, *MOMENT, "--casters", "nobody"), ("--casters", "nobody", "no object")),
        ((*HERE, "--days", "2026-06-21", "--classes", "3,1"), ("--classes", "ascending")),
        ((*MOMENT, "--latitude", 52), ("longitude",)),
    ],
)
def test_bad_arguments(cli, arguments, words):
    cli("shadow", SCENE, *arguments).refused(*words)
