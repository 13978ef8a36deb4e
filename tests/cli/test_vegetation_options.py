"""``--map`` and ``--trees``, of the commands that have them."""

import json
from pathlib import Path

import numpy as np
import pytest

SCENE = "plot.obj"
HERE = "--latitude", 52, "--longitude", 4.36, "--timezone", "Europe/Amsterdam"
DAY = "--days", "2026-06-21", "--step", 60
TREE = "trees.csv?height=h&radius=4&trunk_radius=0&base=0"


@pytest.fixture
def plot(tmp_path):
    """A square of 40, and a tree in its middle."""
    (tmp_path / SCENE).write_text("v -20 -20 0\nv 20 -20 0\nv 20 20 0\nv -20 20 0\nf 1 2 3\nf 1 3 4\n")
    (tmp_path / "trees.csv").write_text("x,y,h\n0,0,12\n")
    return tmp_path


def hours(cli, *more):
    assert cli("sun", SCENE, "--up", "z", *HERE, *DAY, "--sensors", "raster:4", *more, "-o", "a.json").code == 0
    return np.array(json.loads(Path("a.json").read_text())["rows"]["sun_hours"])


def test_trees_shade_the_ground(cli, plot):
    bare = hours(cli)
    dense = hours(cli, "--trees", TREE)
    leaves = hours(cli, "--trees", f"{TREE}&transmittance=0.5")
    year = hours(cli, "--trees", f"{TREE}&transmittance=" + "/".join(["0.9"] * 5 + ["0.5"] + ["0.9"] * 6))
    assert (dense < bare).any() and (dense <= leaves).all() and (leaves <= bare).all()
    assert np.allclose(leaves, year, rtol=1e-6)
    assert np.allclose(leaves, (dense + bare) / 2, rtol=1e-6)
    assert json.loads(Path("a.json").read_text())["about"]["trees"].startswith(TREE)


def test_trees_block_sightlines(cli, plot):
    ask = "los", SCENE, "--up", "z", "--from", "-15,0.3,6", "--to", "15,0.2,6"
    assert cli(*ask, "--json").json()["visible"] == 1
    told = cli(*ask, "--trees", TREE, "--json").json()
    assert told["visible"] == 0 and told["lines"][0]["blocked_by"] == "tree 0"
    seen = "viewshed", SCENE, "--up", "z", "--sensors", "raster:4", "--observer", "-15,0,8", "--json"
    assert cli(*seen, "--trees", TREE).json()["seen"] < cli(*seen).json()["seen"]


def test_trees_of_pictures(cli, plot):
    ask = "render", SCENE, "--up", "z", "--size", "16", "--spp", "1", "--frames", "0:0", "-o", "f.####.png"
    planted = lambda: json.loads(cli(*ask, "--trees", TREE, "--json").out.splitlines()[-1])
    first, again = planted(), planted()
    assert first["scene"]["triangles"] == 50 and first["rendered"] == again["finished"] == [0] and not again["rendered"]
    (plot / "trees.csv").write_text("x,y,h\n0,5,12\n")  # the same file name and options
    assert planted()["rendered"] == [0]
    assert json.loads(cli(*ask, "--json").out.splitlines()[-1])["scene"]["triangles"] == 2


@pytest.mark.parametrize("sensors", ["raster:8+2", "vertex"])
def test_trees_block_pairs_of_sensors(cli, plot, sensors):
    ask = "matrix", SCENE, "--up", "z", "--sensors", sensors, "--targets", "raster:8+6", "--sparse", "m.npz", "--json"
    bare, hidden = (cli(*ask, *more).json() for more in ((), ("--trees", TREE)))
    assert (hidden["rows"], hidden["columns"]) == (bare["rows"], bare["columns"])  # sensors lie below the tree
    assert 0 < hidden["visible"] < bare["visible"]


def test_trees_hide_a_target(cli, plot):
    turbine = "--turbine", "-15,0,0", "--hub-height", 6, "--rotor", 4
    ask = "visible", SCENE, "--up", "z", "--sensors", "raster:8+6", *turbine, "--json"
    bare, hidden = (cli(*ask, *more).json() for more in ((), ("--trees", TREE)))
    assert hidden["sensors"] == bare["sensors"] and hidden["seen_entirely"] < bare["seen_entirely"]


def test_trees_raise_the_horizon_of_points_below_them(cli, plot):
    ask = "skyline", SCENE, "--up", "z", "--azimuth-step", 90, "--eye-height", 1.5, "--on-surface", "--json"
    beside = cli(*ask, "--point", "8,0,0", "--trees", TREE).json()["skylines"][0]
    assert 45 < beside["highest"] < 70 and beside["towards"] == 270 and beside["lowest"] < 0
    below = cli(*ask, "--point", "0,1,0", "--trees", TREE).json()["skylines"][0]
    assert below["lowest"] == below["highest"] == 90  # on the ground below the crown, not on the crown
    assert cli(*ask, "--point", "0,1,0").json()["skylines"][0]["highest"] < 0
    done = cli(*ask, "--point", "8,0,0", "--trees", f"{TREE}&transmittance=0.5")
    assert done.code == 2 and "crowns count as solid; leave transmittance out" in done.err


def test_observers_stand_below_trees(cli, plot):
    ask = "viewshed", SCENE, "--up", "z", "--sensors", "raster:4", "--observer", "0,1,0", "--on-surface", "--json"
    seen = lambda height: cli(*ask, "--eye-height", height, "--trees", TREE).json()["seen"]
    assert seen(1.5) == 100 > seen(12.5)  # from the top of the crown, it would hide the ground below


def test_shadows_of_trees(cli, plot):
    noon = "shadow", SCENE, "--up", "z", *HERE, "--at", "2026-06-21T13:40", "--plane", "0", "--json"
    assert cli(*noon, "-o", "a.gpkg").json()["area"] == 0
    solid = cli(*noon, "--trees", TREE, "-o", "a.gpkg").json()
    assert 50 < solid["area"] < 120 and solid["trees"] == TREE
    leaves = f"{TREE}&transmittance=0.5"
    done = cli(*noon, "--trees", leaves, "-o", "a.gpkg")
    assert done.code == 2 and "with --cell SIZE, they let light pass" in done.err
    days = "shadow", SCENE, "--up", "z", *HERE, *DAY, "--cell", 2, "--classes", "0,0.25,1", "--json", "-o", "a.gpkg"
    hours = [cli(*days, *more).json()["rows"] for more in ((), ("--trees", TREE), ("--trees", leaves))]
    areas = [dict(zip(rows["hours_from"], rows["area"])) for rows in hours]
    assert all(sum(each.values()) == 1600 for each in areas)  # cells lie on the ground, also below the crown
    assert areas[0] == {0: 1600} and 0 < areas[2].get(1, 0) < areas[1][1]


@pytest.mark.parametrize(
    "text, words",
    [
        ("none.csv", "none.csv: no such file"),
        ("trees.csv?hight=3", "'hight' is unknown; did you mean 'height'"),
        ("trees.csv?height=", "height is empty or repeated"),
        ("trees.csv?height=3&height=4", "height is empty or repeated"),
        ("trees.csv?height=h&radius=1&transmittance=0.1/0.2", "JAN/FEB/.../DEC"),
        ("trees.xls", "unknown format of trees"),
        ("trees.csv?height=h", "has no column 'radius' for radius"),
    ],
)
def test_faulty_trees_are_one_line(cli, plot, text, words):
    done = cli("sun", SCENE, "--up", "z", *HERE, *DAY, "--trees", text, "-o", "a.csv")
    assert done.code == 2 and words in done.err and not (plot / "a.csv").exists()


@pytest.mark.parametrize("suffix, head", [("pdf", b"%PDF"), ("svg", b"<?xml"), ("png", b"\x89PNG")])
def test_map_sheets(cli, plot, suffix, head):
    pytest.importorskip("matplotlib")
    name = f"sheet.{suffix}"
    told = cli("sun", SCENE, "--up", "z", *HERE, *DAY, "--sensors", "raster:4", "--map", name, "--json").json()
    assert told["files"] == [name] and (plot / name).read_bytes().startswith(head)
    assert sorted(each.name for each in plot.iterdir()) == [SCENE, name, "trees.csv"]


def test_map_sheets_of_viewsheds(cli, plot):
    pytest.importorskip("matplotlib")
    ask = "viewshed", SCENE, "--up", "z", "--sensors", "raster:4", "--observer", "0,0,3"
    assert cli(*ask, "--map", "seen.svg", "--json").json()["outputs"] == ["seen.svg"]
    assert "what the observer sees" in (plot / "seen.svg").read_text().lower()
    assert cli(*ask, "--map", "seen.jpg").code == 2


@pytest.mark.parametrize("suffix, head", [("pdf", b"%PDF"), ("svg", b"<?xml"), ("png", b"\x89PNG")])
def test_map_sheets_of_shadows_and_skylines(cli, plot, suffix, head):
    pytest.importorskip("matplotlib")
    name, trees = f"sheet.{suffix}", ("--trees", TREE, "--crs", "EPSG:28992")
    moment = "shadow", SCENE, "--up", "z", *HERE, "--at", "2026-06-21T13:40", *trees, "--map", name
    days = "shadow", SCENE, "--up", "z", *HERE, *DAY, "--cell", 4, *trees, "--map", name
    horizon = "skyline", SCENE, "--up", "z", "--point", "8,0,2", "--north", "1", *trees, "--map", name
    for ask in moment, days, horizon:
        told = cli(*ask, "--json").json()
        assert told.get("files", told.get("outputs")) == [name]
        assert (plot / name).read_bytes().startswith(head)
        (plot / name).unlink()
    assert sorted(each.name for each in plot.iterdir()) == [SCENE, "trees.csv"]


def test_a_diagram_shows_one_point(cli, plot):
    done = cli("skyline", SCENE, "--up", "z", "--point", "8,0,2", "--point", "9,0,2", "--map", "sheet.pdf")
    assert done.code == 2 and "sheet.pdf: a diagram shows one point, and there are 2" in done.err
    assert cli("skyline", SCENE, "--up", "z", "--point", "8,0,2", "--map", "sheet.jpg").code == 2


def test_geopackages_and_styles(cli, plot):
    pytest.importorskip("pyogrio")
    done = cli("sun", SCENE, "--up", "z", "--crs", "EPSG:28992", *HERE, *DAY, "-o", "a.gpkg", "--sensors", "raster:8")
    assert done.code == 0 and (plot / "a.qml").exists()
    frame = pytest.importorskip("geopandas").read_file("a.gpkg")
    assert frame.crs == "EPSG:28992" and "sun_hours" in frame.columns and len(frame) == 36
