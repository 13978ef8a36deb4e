"""`antumbra los`, `antumbra viewshed` and `antumbra matrix`."""

import csv
import json
from pathlib import Path

import numpy as np
import pytest
import scipy.sparse
from PIL import Image

import antumbra as at
from antumbra.city.tables.bit_matrices import unpack_bits
from command_line import TRIANGLES
from scenes import scene_path

SCENE = f"procedural:atrium?triangles={TRIANGLES}"


@pytest.fixture
def wall(tmp_path):
    """A wall in the plane z = 0 from x = -1 to 1, 2 high, on a floor."""
    path = tmp_path / "wall.obj"
    path.write_text(
        "v -1 0 0\nv 1 0 0\nv 1 2 0\nv -1 2 0\nv -5 0 5\nv 5 0 5\nv 5 0 -5\nv -5 0 -5\n"
        "usemtl wall\nf 1 2 3\nf 1 3 4\nusemtl floor\nf 5 6 7\nf 5 7 8\n"
    )
    return path


def test_lines_say_what_blocks(cli, wall):
    asked = "--from", "0,1,3", "--to", "0,1,-3", "--to", "3,1,-3"
    told = cli("los", wall, *asked, "-o", "a.csv", "-o", "a.glb", "--json").json()
    assert (told["pairs"], told["visible"]) == (2, 1) and told["outputs"] == ["a.csv", "a.glb"]
    blocked, seen = told["lines"]
    assert blocked["visible"] == "no" and blocked["distance"] == 3.0 and seen["visible"] == "yes"
    rows = list(csv.DictReader(Path("a.csv").read_text().splitlines()))
    assert [row["visible"] for row in rows] == ["False", "True"] and rows[0]["name"] == blocked["blocked_by"] != ""
    assert [float(rows[0][name]) for name in ("px", "py", "pz")] == pytest.approx([0, 1, 0], abs=1e-6)
    assert rows[1]["px"] == "" and rows[1]["object"] == "-1"
    root = Path("a.glb").read_bytes()
    assert b'"seen"' in root and b'"hidden"' in root
    shown = cli("los", wall, *asked)
    assert shown.code == 0 and "1 of 2 pairs" in shown.out and blocked["blocked_by"] in shown.out


def test_pairs_from_files(cli, wall, tmp_path):
    (tmp_path / "a.csv").write_text("x,y,z\n0,1,3\n4,1,3\n")
    np.save("b.npy", [[0, 1, -3], [4, 1, -3]])
    count = lambda *more: cli("los", wall, *more, "--json").json()
    files = "--observers", "a.csv", "--targets", "b.npy"
    assert count(*files)["pairs"] == 4
    zipped = count(*files, "--pairs", "zip")
    assert [line["visible"] for line in zipped["lines"]] == ["no", "yes"]
    (tmp_path / "pairs.csv").write_text("from,to\n1,1\n0,0\n0,1\n")
    listed = count(*files, "--pairs", "pairs.csv")
    assert [line["visible"] for line in listed["lines"]][:2] == ["yes", "no"] and listed["pairs"] == 3
    ends = "x1,y1,z1,x2,y2,z2,nx1,ny1,nz1"
    (tmp_path / "ends.csv").write_text(f"{ends}\n0,1,0,0,1,3,0,0,1\n0,1,0,0,1,3,0,0,-1\n")
    both = count("--pairs", "ends.csv")
    assert [line["visible"] for line in both["lines"]] == ["yes", "no"]  # a point of the wall, seen from its two sides


@pytest.mark.parametrize(
    "arguments, words",
    [
        ((), ["there are no points"]),
        (("--from", "0,0,0"), ["observers need targets"]),
        (("--from", "0,0", "--to", "0,0,0"), ["--from", "three finite numbers"]),
        (("--from", "0,0,0", "--observers", "a.csv"), ["exclude each other"]),
        (("--pairs", "some"), ["--pairs", "all, zip"]),
        (("--from", "0,0,0", "--to", "1,1,1", "--to", "2,2,2", "--pairs", "zip"), ["1 observers and 2 targets"]),
        (("--from", "0,0,0", "--to", "1,1,1", "-o", "a.png"), [".png", ".csv"]),
    ],
)
def test_bad_lines(cli, arguments, words, wall):
    cli("los", wall, *arguments).refused(*words)


def test_bad_indices(cli, wall, tmp_path):
    (tmp_path / "pairs.csv").write_text("from,to\n0,1\n")
    given = "--from", "0,0,0", "--to", "1,1,1", "--pairs", "pairs.csv"
    cli("los", wall, *given).refused("column 'to'", "from 0 to 0")
    (tmp_path / "pairs.csv").write_text("a,b\n0,0\n")
    cli("los", wall, *given).refused("from and to")


def test_a_viewshed_in_files(cli, wall):
    asked = "viewshed", wall, "--sensors", "raster:0.5", "--observer", "0,0,3", "--observer", "4,0,3", "--on-surface"
    told = cli(*asked, "--eye-height", "1", "-o", "a.npz", "-o", "a.png", "--bits", "b.npy", "--json").json()
    assert told["sensors"] == 400 and told["observers"] == 2 and 0 < told["seen"] < 400
    assert told["area"] == pytest.approx(100) and told["area_seen"] == pytest.approx(told["seen"] / 4)
    with np.load("a.npz") as read:
        seen = read["seen"]
        assert json.loads(str(read["about"]))["about"]["eye_height"] == 1
    assert np.array_equal(unpack_bits(np.load("b.npy"), 2).sum(1), seen) and set(seen.tolist()) == {0, 1, 2}
    assert np.asarray(Image.open("a.png")).shape[0] > 500
    near = cli(*asked, "--eye-height", "1", "--max-distance", "2", "--azimuth", "270:90", "--json").json()
    assert 0 < near["seen"] < told["seen"] / 2
    assert "seen by any" in cli(*asked).out


@pytest.mark.parametrize(
    "arguments, words",
    [
        ((), ["there is no observer"]),
        (("--observer", "0,0,0", "--azimuth", "3"), ["--azimuth", "FROM:TO"]),
        (("--observer", "0,0,0", "--sensors", "cells"), ["--sensors", "grid:SPACING"]),
        (("--observer", "0,0,0", "-o", "a.tif"), ["holds a raster"]),
        (("--observer", "0,0,0", "--max-distance", "-3"), ["--max-distance"]),
        (("--observer", "0,0,0", "--bits", "a.csv"), [".npy"]),
        (("--observers", "a.txt"), ["--observers", ".csv"]),
    ],
)
def test_bad_viewsheds(cli, arguments, words):
    cli("viewshed", SCENE, *arguments).refused(*words)


def test_a_matrix_in_files(cli):
    told = cli("matrix", SCENE, "-o", "a.npy", "--sparse", "a.npz", "--counts", "a.csv", "--json").json()
    bits, pairs = np.load("a.npy"), scipy.sparse.load_npz("a.npz")
    assert told["rows"] == told["columns"] == len(bits) and told["visible"] == pairs.nnz > 0
    assert np.array_equal(unpack_bits(bits, told["columns"]), pairs.toarray())
    assert (pairs != pairs.T).nnz == 0
    seen = [int(row["seen"]) for row in csv.DictReader(Path("a.csv").read_text().splitlines())]
    assert np.array_equal(seen, np.bitwise_count(bits).sum(1))


def test_a_matrix_of_sensors_and_targets(cli, wall, tmp_path):
    (tmp_path / "eyes.csv").write_text("x,y,z\n0,1,3\n0,1,-3\n")
    shown = cli("matrix", wall, "--sensors", "eyes.csv", "--targets", "face", "-o", "a.npy")
    assert shown.code == 0 and "2 x 4" in shown.out
    scene = at.load(wall)
    wanted = at.visibility_matrix(scene, [[0, 1, 3], [0, 1, -3]], at.face_sensors(scene))
    assert np.array_equal(np.load("a.npy"), wanted.bits) and wanted.counts[0] > wanted.counts[1] > 0


@pytest.mark.parametrize(
    "arguments, words",
    [
        ((), ["nothing to write"]),
        (("--targets", "cells", "-o", "a.npy"), ["--targets", "grid:SPACING"]),
        (("-o", "a.npz"), [".npy"]),
        (("--sparse", "a.npy"), [".npz"]),
        (("--counts", "a.tif"), ["holds a raster"]),
    ],
)
def test_bad_matrices(cli, arguments, words):
    cli("matrix", SCENE, *arguments).refused(*words)


def test_a_viewshed_of_a_real_city(cli):
    city = scene_path("delft_city/scene.glb")
    asked = (
        "viewshed",
        city,
        "--up",
        "z",
        "--sensors",
        "raster:4",
        "--observer=-29.5,-60,0",
        "--on-surface",
        "--eye-height",
        "1.6",
    )
    told = cli(*asked, "--json").json()
    assert 0.02 < told["seen"] / told["sensors"] < 0.5
    curved = cli(*asked, "--curvature", "--json").json()
    assert abs(curved["seen"] - told["seen"]) < 0.01 * told["sensors"]
