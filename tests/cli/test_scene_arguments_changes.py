"""--add, --remove and --before: what they place, and that every study has both states."""

import csv
import json

import numpy as np
import pytest

import city_files
from gltf_files import Gltf

TOWER = """o tower
v 0 0 0
v 8 0 0
v 8 8 0
v 0 8 0
v 0 0 40
v 8 0 40
v 8 8 40
v 0 8 40
f 4 3 2 1
f 5 6 7 8
f 1 2 6 5
f 2 3 7 6
f 3 4 8 7
f 4 1 5 8
"""
ADD = "--add", "tower.obj?up=z&at=85010,446985,0"
DAY = "--days", "2026-03-21", "--step", 60, "--timezone", "+01:00"
STUDIES = {  # command -> (words, file of both states, a quantity)
    "sun": ((*DAY, "--sensors", "grid:1"), "out.csv", "sun_hours"),
    "visible": (
        ("--sensors", "grid:1", "--turbine", "85015,446900,0", "--hub-height", 60, "--rotor", 40),
        "out.csv",
        "share",
    ),
    "viewshed": (("--sensors", "grid:1", "--observer", "85015,446950,2"), "out.csv", "seen"),
    "skyline": (("--point", "85005,447005,11", "--azimuth-step", 30), "out.csv", "elevation"),
    "los": (("--from", "85005,446999,5", "--to", "85020,446960,5"), "out.csv", None),
    "matrix": (("--sensors", "grid:1", "--targets", "targets.csv"), "counts.csv", "seen"),
}


@pytest.fixture
def town(tmp_path):
    """A cube of 10 m in the CRS of Delft, and a tower as an OBJ file with z up."""
    cubes = {"house": city_files.building(city_files.solid()), "shed": city_files.building(shed())}
    corners = np.concatenate([city_files.CUBE * 10.0, city_files.CUBE * 3.0 + (20.0, 0.0, 0.0)]) + (85000, 447000, 0)
    city_files.put(tmp_path, city_files.city(cubes, vertices=corners))
    (tmp_path / "tower.obj").write_text(TOWER)
    (tmp_path / "targets.csv").write_text("x,y,z\n85014,446950,5\n85020,446960,2\n")
    return "a.city.json"


def shed():
    return {"type": "Solid", "lod": "1", "boundaries": [[[[8 + i for i in face]] for face in city_files.CUBE_FACES]]}


def rows_of(path):
    with open(path, newline="", encoding="utf-8") as file:
        return list(csv.DictReader(file))


@pytest.mark.parametrize("study", STUDIES)
def test_every_study_has_both_states_of_each_quantity(cli, tmp_path, town, study):
    words, name, quantity = STUDIES[study]
    option = "--counts" if study == "matrix" else "-o"
    done = cli(study, town, *words, *ADD, "--remove", "shed", "--before", option, name)
    assert done.code == 0, done.err
    assert "note: added tower: 12 triangles, x 85010 to 85018, y 446985 to 446993, z 0 to 40" in done.err
    assert "note: removed shed" in done.err
    rows = rows_of(tmp_path / name)
    if quantity is None:
        assert [(row["visible_before"], row["visible"]) for row in rows] == [("True", "False")]
        return
    before, after, loss = (np.array([float(row[quantity + end]) for row in rows]) for end in ("_before", "", "_loss"))
    assert np.array_equal(loss, before - after) and (loss != 0.0).any()
    assert not any("shed" in row.get("building", "") or "tower" in row.get("building", "") for row in rows)


def test_view_factors_of_both_states_have_the_same_rays(cli, tmp_path, town):
    words = "view-factors", town, "--per", "building", "--samples", 4096
    assert cli(*words, *ADD, "--remove", "shed", "--before", "-o", "out.csv").code == 0
    rows = {(row["from"], row["to"]): row for row in rows_of(tmp_path / "out.csv")}
    assert {one for one, _ in rows} == {"house"} and float(rows["house", "tower"]["factor_before"]) == 0.0
    assert float(rows["house", "shed"]["factor"]) == 0.0 < float(rows["house", "shed"]["factor_loss"])
    assert abs(sum(float(row["factor_loss"]) for row in rows.values())) < 1e-12
    away = (
        "view-factors",
        town,
        "--per",
        "building",
        "--samples",
        4096,
        "--add",
        "tower.obj?up=z&at=84980,447000,-100",
    )
    assert cli(*away, "--before", "-o", "away.csv").code == 0
    losses = {row["to"]: float(row["factor_loss"]) for row in rows_of(tmp_path / "away.csv") if row["from"] == "house"}
    assert losses["shed"] == losses["sky"] == 0.0 and losses["tower"] < 0.0 < losses["ground"]
    refused = cli(*away, "--before", "-o", "a.npz")
    assert refused.code == 2 and "a.npz: both states, as by --before, are written as .csv" in refused.err


@pytest.mark.parametrize("suffix", ["csv", "json", "npz", "parquet", "gpkg", "png", "glb", "tif"])
def test_every_output_has_the_loss(cli, tmp_path, town, suffix):
    done = cli("sun", town, *DAY, "--sensors", "raster:2", *ADD, "--before", "-o", f"out.{suffix}", "--json").json()
    assert done["change"] == ["added tower: 12 triangles, x 85010 to 85018, y 446985 to 446993, z 0 to 40"]
    assert done["means"]["sun_hours_loss"] > 0.0
    if suffix == "json":
        document = json.loads((tmp_path / "out.json").read_text())
        assert {"sun_hours_loss", "sun_hours_before", "sun_hours"} <= set(document["rows"])
        assert document["about"]["change"] == done["change"]
    if suffix == "tif":
        rasterio = pytest.importorskip("rasterio")
        with rasterio.open(tmp_path / "out.tif") as file:
            assert file.descriptions[:3] == ("sun_hours_loss", "sun_hours_before", "sun_hours")


def test_both_states_are_those_of_two_runs_with_windows_from_a_file(cli, tmp_path, town):
    (tmp_path / "windows.csv").write_text(
        "id,dwelling,x,y,z,nx,ny,nz\nw1,ground,85002,447000,2,0,-1,0\nw2,ground,85008,447000,2,0,-1,0\n"
        "w3,top,85005,447000,8,0,-1,0\nw4,top,85000,447005,8,-1,0,0\n"
    )
    here = "--latitude", 52, "--longitude", 4.36, "--north", 0  # that of the CRS is at the middle of a scene
    words = *DAY, *here, "--sensors", "windows.csv", "--energy"
    assert cli("sun", town, *words, *ADD, "--before", "-o", "both.csv").code == 0
    assert cli("sun", town, *words, "-o", "before.csv").code == 0
    assert cli("sun", town, *words, *ADD, "-o", "after.csv").code == 0
    both, before, after = (rows_of(tmp_path / f"{name}.csv") for name in ("both", "before", "after"))
    assert [row["id"] for row in both] == ["w1", "w2", "w3", "w4"] and {row["dwelling"] for row in both} == {
        "ground",
        "top",
    }
    for name in ("sun_hours", "direct_kwh_m2", "first"):
        assert [row[f"{name}_before"] for row in both] == [row[name] for row in before]
        assert [row[name] for row in both] == [row[name] for row in after]
    assert cli("sun", town, *words, *ADD, "--before", "--per", "dwelling", "-o", "per.csv").code == 0
    per = rows_of(tmp_path / "per.csv")
    assert [row["dwelling"] for row in per] == ["ground", "top"] and [row["sensors"] for row in per] == ["2", "2"]
    losses = [float(row["sun_hours_loss"]) for row in both]
    assert [float(row["sun_hours_loss"]) for row in per] == [sum(losses[:2]) / 2.0, sum(losses[2:]) / 2.0]


def test_shards_of_both_states_merge_byte_for_byte(cli, tmp_path, town):
    words = "sun", town, *DAY, "--sensors", "grid:1", *ADD, "--before"
    assert cli(*words, "-o", "whole.csv").code == 0
    for k in range(2):
        assert cli(*words, "-o", "split.csv", "--shard", f"{k}/2").code == 0
    assert cli("merge", "split.shards").code == 0
    assert (tmp_path / "split.csv").read_bytes() == (tmp_path / "whole.csv").read_bytes()
    assert not list(tmp_path.glob("*.parts"))


def test_trees_stand_in_both_states(cli, tmp_path, town):
    geopandas, shapely = pytest.importorskip("geopandas"), pytest.importorskip("shapely")
    places = shapely.points([[85005.0, 446996.0], [85016.0, 446960.0]])
    layer = geopandas.GeoDataFrame(
        {"height": [8.0, 8.0], "radius": [2.0, 2.0], "base": [0.0, 0.0]}, geometry=places, crs=28992
    )
    layer.to_file(tmp_path / "trees.gpkg")
    words = "sun", town, *DAY, "--sensors", "grid:1", *ADD, "--before"
    assert cli(*words, "-o", "bare.csv").code == 0
    assert cli(*words, "--trees", "trees.gpkg?base=base", "-o", "planted.csv").code == 0
    bare, planted = (rows_of(tmp_path / f"{name}.csv") for name in ("bare", "planted"))
    assert [row["x"] for row in bare] == [row["x"] for row in planted]
    hours = [[float(row["sun_hours_before"]) for row in rows] for rows in (bare, planted)]
    assert sum(hours[1]) < sum(hours[0]) and all(float(row["sun_hours_loss"]) >= 0.0 for row in planted)


@pytest.mark.parametrize("name", ["tower.obj", "tower.glb", "tower.city.json", "tower.geojson"])
def test_obj_gltf_cityjson_and_footprints_are_added_alike(cli, tmp_path, town, name):
    where = {"tower.obj": "?up=z&at=85010,446985,0", "tower.glb": "?at=85010,446985,0", "tower.geojson": "?base=0"}
    if name == "tower.glb":
        put_glb(tmp_path / name)
    elif name == "tower.city.json":
        corners = city_files.CUBE * (8.0, 8.0, 40.0) + (85010.0, 446985.0, 0.0)
        city_files.put(tmp_path, city_files.city(vertices=corners), name)
    elif name == "tower.geojson":
        pytest.importorskip("geopandas")
        ring = [[85010, 446985], [85018, 446985], [85018, 446993], [85010, 446993], [85010, 446985]]
        crs = {"type": "name", "properties": {"name": "urn:ogc:def:crs:EPSG::28992"}}
        feature = {
            "type": "Feature",
            "properties": {"height": 40},
            "geometry": {"type": "Polygon", "coordinates": [ring]},
        }
        (tmp_path / name).write_text(json.dumps({"type": "FeatureCollection", "crs": crs, "features": [feature]}))
    done = cli(
        "sun", town, *DAY, "--sensors", "grid:2", "--add", name + where.get(name, ""), "--before", "-o", "out.csv"
    )
    assert done.code == 0 and "x 85010 to 85018, y 446985 to 446993, z 0 to 40" in done.err
    assert cli("sun", town, *DAY, "--sensors", "grid:2", *ADD, "--before", "-o", "obj.csv").code == 0
    assert (tmp_path / "out.csv").read_bytes() == (tmp_path / "obj.csv").read_bytes()


def put_glb(path):
    """The tower as glTF, with y up."""
    lines = [line.split() for line in TOWER.splitlines()]
    corners = np.array([[float(x) for x in rest] for kind, *rest in lines if kind == "v"], np.float32)
    quads = [[int(k) - 1 for k in rest] for kind, *rest in lines if kind == "f"]
    faces = np.array([face for a, b, c, d in quads for face in ((a, b, c), (a, c, d))], np.uint16)
    gltf = Gltf()
    upright = corners[:, [0, 2, 1]] * np.array([1, 1, -1], np.float32)
    gltf.node(mesh=gltf.mesh(gltf.primitive(upright, faces)), name="tower")
    path.write_bytes(gltf.glb())


@pytest.mark.parametrize(
    "words, message",
    [
        (["--before"], "--before compares the scene with its change; give --add FILE or --remove ID, too"),
        (["--remove", "hose"], "remove is 'hose', and a has no such object; similar ones are house"),
        (
            ["--add", "tower.obj?up=z"],
            "tower: would lie at 4,4, far beside a at 85011.5,447005; give the position of its origin",
        ),
        (["--add", "tower.obj?at=1,2"], "--add tower.obj?at"),
        (["--add", "tower.obj?at=1,2,3&at=4,5,6"], "at is empty or repeated; write FILE?at=VALUE"),
        (["--add", "dem.tif"], "rasters are scenes or terrain"),
        (["--add", "none.obj"], "none.obj"),
    ],
)
def test_wrong_changes_are_refused_before_anything_is_written(cli, tmp_path, town, words, message):
    done = cli("sun", town, *DAY, *words, "-o", "out.csv")
    assert done.code == 2 and message in done.err and not (tmp_path / "out.csv").exists()


def test_bakes_and_stores_refuse_changes(cli, tmp_path, town):
    for command in (("bake", "tower.obj", "-o", "a.glb"), ("build", "tower.obj", "-o", "a.antumbra")):
        for option, value in (("--remove", "tower"), ("--add", "tower.obj")):
            done = cli(*command, option, value)
            assert done.code == 2 and f"{option} {value}: " in done.err and len(list(tmp_path.iterdir())) == 3


def test_pictures_show_the_changed_scene(cli, tmp_path, town):
    for name, change in (("a", ()), ("b", ADD), ("c", ("--remove", "shed"))):
        assert cli("render", town, "--size", "32x32", *change, "-o", f"{name}.png").code == 0
    pictures = [(tmp_path / f"{name}.png").read_bytes() for name in "abc"]
    assert len(set(pictures)) == 3
