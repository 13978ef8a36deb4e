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
    assert "observers that see it" in (plot / "seen.svg").read_text().lower()
    assert cli(*ask, "--map", "seen.jpg").code == 2


def test_geopackages_and_styles(cli, plot):
    pytest.importorskip("pyogrio")
    done = cli("sun", SCENE, "--up", "z", "--crs", "EPSG:28992", *HERE, *DAY, "-o", "a.gpkg", "--sensors", "raster:8")
    assert done.code == 0 and (plot / "a.qml").exists()
    frame = pytest.importorskip("geopandas").read_file("a.gpkg")
    assert frame.crs == "EPSG:28992" and "sun_hours" in frame.columns and len(frame) == 36
