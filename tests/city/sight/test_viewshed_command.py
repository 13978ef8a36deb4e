"""`antumbra viewshed`."""

import json

import numpy as np
import pytest
from PIL import Image

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
