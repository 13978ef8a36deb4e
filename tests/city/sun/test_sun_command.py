"""``antumbra sun``: its outputs, its answers and its errors. tests/city/sun has what the numbers are."""

import csv
import json

import numpy as np
import pytest
from PIL import Image

import antumbra as at
import city_files
from gltf_files import Gltf

SCENE = "procedural:city?triangles=3000"
HERE = "--latitude", 52, "--longitude", 4.36, "--timezone", "Europe/Amsterdam"
DAY = "--days", "2026-03-21", "--step", 120


def put_town(folder):
    """A unit cube in the CRS of Delft."""
    cubes = {"a": city_files.building(city_files.solid())}
    return city_files.put(folder, city_files.city(cubes, vertices=city_files.CUBE + (85000, 447000, 0)))


def test_every_kind_of_output(cli, tmp_path):
    names = [f"o.{suffix}" for suffix in ("png", "csv", "json", "npz", "parquet", "glb", "tif")]
    outputs = [word for name in names for word in ("-o", name)]
    told = cli("sun", SCENE, *HERE, *DAY, "--sensors", "raster:8", *outputs, "--matrix", "m.npy", "--json").json()
    assert told["files"] == [*names, "m.npy"] and told["suns"] == 6
    assert told["rays"] == told["sensors"] * 6 > 600 and 0 < told["means"]["sun_hours"] < 12
    with open(tmp_path / "o.csv", newline="") as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == told["sensors"]
    hours = np.array([float(row["sun_hours"]) for row in rows])
    assert np.isclose(hours.mean(), told["means"]["sun_hours"])
    assert np.array_equal(np.load(tmp_path / "o.npz")["sun_hours"], hours)
    assert json.loads((tmp_path / "o.json").read_text())["rows"]["sun_hours"] == hours.tolist()
    with Image.open(tmp_path / "o.png") as image:
        assert len(image.getcolors(1 << 20)) > 16
    assert np.load(tmp_path / "m.npy").shape == (told["sensors"], 1)
    assert not list(tmp_path.glob("*.parts"))


def test_a_city_knows_its_place_and_gets_attributes(cli, tmp_path):
    put_town(tmp_path)
    done = cli("sun", "a.city.json", *DAY, "--timezone", "+01:00", "-o", "a.csv", "--city-output", "b.json")
    assert done.code == 0 and "52.0" in done.out and "b.json" in done.out
    written = json.loads((tmp_path / "b.json").read_text())["CityObjects"]["a"]["attributes"]
    scene = at.load(tmp_path / "a.city.json")
    place = at.place_of(scene, timezone="+01:00")
    table = at.sun_hours(scene, "face", "2026-03-21", step=120, place=place)
    areas = table.sensors.areas
    assert np.isclose(written["sun_hours"], (table["sun_hours"] * areas).sum() / areas.sum())


def test_a_store_has_a_plan_of_its_own(cli):
    assert cli("build", SCENE, "-o", "a.antumbra").code == 0
    told = [cli("sun", each, *HERE, *DAY, "--sensors", "raster:8", "-o", "a.csv", "--json").json()
            for each in (SCENE, "a.antumbra")]  # fmt: skip
    assert [each["plan"] for each in told] == ["auto", "bsah+chcrt"] and told[0]["means"] == told[1]["means"]


def test_a_row_per_building(cli, tmp_path):
    roofed = city_files.solid(semantics={"surfaces": [{"type": "WallSurface"}], "values": [[None, None, 0, 0, 0, 0]]})
    vertices = city_files.CUBE + (85000, 447000, 0)
    city_files.put(tmp_path, city_files.city({"a": city_files.building(roofed)}, vertices=vertices))
    chosen = "--surfaces", "WallSurface", "--facing", "150:210", "--per", "building"
    outputs = "-o", "a.csv", "-o", "a.png", "--city-output", "b.json"
    told = cli("sun", "a.city.json", *DAY, "--timezone", "+01:00", *chosen, "--energy", *outputs, "--json").json()
    assert (told["sensors"], told["rows"], told["per"], told["facing"]) == (2, 1, "building", [150.0, 210.0])
    assert told["rays"] == 2 * told["suns"] and not {"azimuth", "tilt"} & told["means"].keys()
    with open(tmp_path / "a.csv", newline="") as file:
        (row,) = csv.DictReader(file)
    assert row["building"] == "a" and float(row["area"]) == 1.0 and row["sensors"] == "2"
    assert float(row["direct_kwh"]) == float(row["direct_kwh_m2"]) == told["means"]["direct_kwh"] > 0
    attributes = json.loads((tmp_path / "b.json").read_text())["CityObjects"]["a"]["attributes"]
    assert attributes["sun_hours"] == float(row["sun_hours"]) > 0 and not {"azimuth", "tilt"} & attributes.keys()
    done = cli("sun", "a.city.json", *DAY, "--timezone", "+01:00", "--per", "building", "-o", "a.csv")
    assert done.code == 0 and "buildings" in done.out
    refused = cli("sun", "a.city.json", *DAY, "--sensors", "raster:0.5", "--per", "building", "-o", "a.tif")
    assert refused.code != 0 and "GeoTIFF holds a raster" in refused.err


def test_a_rule_and_its_share(cli):
    done = cli("sun", SCENE, *HERE, "--rule", "en17037-minimum", "--step", 60, "--sensors", "raster:10", "-o", "a.csv")
    assert done.code == 0 and "sensors on surfaces pass (" in done.out


@pytest.mark.parametrize(
    "given, words",
    [
        ((SCENE, *DAY), ("place is unknown; give --latitude and --longitude, --crs, or --epw",)),
        ((SCENE, *HERE), ("days are unknown; give --days, such as", "or year:2026, --rule, or --epw")),
        ((SCENE, "--longitude", "4"), ("--longitude needs its latitude; give both",)),
        ((), ("SCENE is missing, such as model.glb or example:town; see antumbra sun --help",)),
        ((SCENE, *HERE, *DAY, "--sensors", "windows"), ("--sensors is 'windows'", "grid:SPACING")),
        ((SCENE, *HERE, *DAY, "--sensors", "windows.csv"), ("windows.csv", "no such file")),
        ((SCENE, *HERE, *DAY, "-o", "a.xyz"), ("a.xyz", ".csv")),
        ((SCENE, *HERE, *DAY, "-o", "a.tif"), ("holds a raster", "face")),
        ((SCENE, *HERE, *DAY, "--city-output", "b.json"), ("for CityJSON",)),
        ((SCENE, *HERE, "--days", "2026-02-30"), ("2026-02-30", "choose a day")),
        ((SCENE, *HERE, *DAY, "--rule", "none"), ("rule 'none' is unknown", "br209-apsh")),
        ((SCENE, *HERE, *DAY, "--column", "moon", "-o", "a.png"), ("no column 'moon'", "sun_hours")),
        ((SCENE, *HERE, *DAY, "--plan", "fast"), ("fast",)),
    ],
)
def test_bad_input_is_named(cli, tmp_path, given, words):
    cli("sun", *given).refused(*words)
    assert not [p for p in tmp_path.iterdir() if p.suffix != ".parts"]


YEAR = "0.7/0.7/0.6/0.4/0.3/0.2/0.2/0.2/0.3/0.5/0.6/0.7"


def put_park(folder):
    """A triangular sail over a larger floor, each an object."""
    file = Gltf()
    floor = np.array([[-9, 0, -9], [-9, 0, 9], [9, 0, 9]], np.float32)
    file.node(name="floor", mesh=file.mesh(file.primitive(floor)))
    file.node(name="sail", mesh=file.mesh(file.primitive(floor * np.float32(4 / 9) + np.float32([0, 1, 0]))))
    (folder / "park.glb").write_bytes(file.glb())


def test_leaves_of_each_month(cli, tmp_path):
    put_park(tmp_path)
    days = "--days", "2026-01-15,2026-07-15", "--latitude", 0, "--longitude", 0, "--step", 1440, "--by", "month"
    means = {}
    for share in ("1", "0.7/1,0.5,0/0/0/0/0/0.2/0/0/0/0/0"):
        told = cli("sun", f"park.glb?transmittance=sail:{share}", "--up", "y", *days, "-o", "a.csv", "--json").json()
        assert told["suns"] == 2
        with open(tmp_path / "a.csv", newline="") as file:
            first = next(csv.DictReader(file))
        means[share] = [float(first[name]) for name in ("hours_jan", "hours_jul")]
    full, leaves = means.values()
    assert full == [24, 24] and told["sensors"] == 2 and np.allclose(leaves, [24 * 0.7, 24 * 0.2], rtol=1e-6)


@pytest.mark.parametrize(
    "query, words",
    [
        (f"sai:{YEAR}", ("no material or object is called 'sai'", "sail")),
        (YEAR, ("write NAME:SHARE", "NAME:JAN/FEB/.../DEC")),
        (f"sail:{YEAR}/0.7", ("sail:0.7/0.7", "twelve")),
        ("sail:0.7/0.7", ("twelve",)),
        (f"sail:{YEAR[:-3]}", ("transmittance is ''",)),
        (f"sail:{YEAR[:-3]}1,2", ("twelve",)),
        (f"sail:{YEAR[:-3]}1.5", ("transmittance of 'sail' in dec is 1.5", "from 0 to 1")),
        (f"sail:{YEAR[:-3]}0,0,-1", ("in dec is -1",)),
        (f"sail:{YEAR[:-3]}x", ("transmittance is 'x'", "a finite number")),
        (f"sail:{YEAR[:-3]}nan", ("transmittance is 'nan'",)),
        (f"sail:{YEAR.replace('/', ';')}", ("park.glb",)),
        (f"sail:{YEAR}&months=12", ("'months' is unknown",)),
    ],
)
def test_bad_transmittances_are_named(cli, tmp_path, query, words):
    put_park(tmp_path)
    cli("sun", f"park.glb?transmittance={query}", "--up", "y", *HERE, *DAY, "-o", "a.csv").refused(*words)
    assert {p.name for p in tmp_path.iterdir()} == {"park.glb"}
