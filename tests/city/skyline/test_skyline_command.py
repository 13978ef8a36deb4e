"""`antumbra skyline`."""

import json
from pathlib import Path

import numpy as np
import pytest

import antumbra as at

SCENE = "procedural:city?triangles=3000"
EYES = "--point", "0,60,0", "--point", "3,1.5,40"


def test_files_and_answers_are_those_of_the_function(cli):
    told = cli(
        "skyline", SCENE, *EYES, "--azimuth-step", 10, "--north", 0.8, "-o", "a.csv", "-o", "a.npz", "--json"
    ).json()
    want = at.skyline(at.procedural("city", triangles=3000), [[0, 60, 0], [3, 1.5, 40]], azimuth_step=10, north=0.8)
    assert told["outputs"] == ["a.csv", "a.npz"] and (told["points"], told["azimuths"], told["north"]) == (2, 36, 0.8)
    assert told["sky_view_factor"] == pytest.approx(want.sky_view_factor().mean())
    with np.load("a.npz") as arrays:
        assert np.array_equal(arrays["elevation"], want.elevation) and np.ptp(want.elevation) > 20.0
    assert len(Path("a.csv").read_text().splitlines()) == 1 + 72
    first = told["skylines"][0]
    assert first["highest"] == pytest.approx(want.highest[0].max(), abs=1e-3) and first["point"] == "0,60,0"
    shown = cli("skyline", SCENE, *EYES)
    assert shown.code == 0 and "2 points x 360 azimuths" in shown.out and "sky view factor" in shown.out


def test_a_pvgis_file_of_one_point(cli):
    assert cli("skyline", SCENE, *EYES[2:], "--azimuth-step", 7.5, "--highest", "-o", "a.txt", "-q").code == 0
    lines = [float(line) for line in Path("a.txt").read_text().split()]
    want = at.skyline(at.procedural("city", triangles=3000), [3, 1.5, 40], azimuth_step=7.5)
    assert np.allclose(lines, np.maximum(want.highest[0], 0.0), rtol=1e-5) and max(lines) > 10.0


def test_points_from_files_and_on_surfaces(cli):
    Path("p.csv").write_text("x,y,z\n0,-5,40\n10,-5,40\n")
    lifted = cli(
        "skyline", SCENE, "--points", "p.csv", "--on-surface", "--eye-height", 2, "-o", "a.json", "--json"
    ).json()
    assert lifted["points"] == 2
    heights = np.array(json.loads(Path("a.json").read_text())["points"])[:, 1]
    assert (heights > 1.5).all()
    rastered = cli("skyline", SCENE, "--points", "raster:40", "--eye-height", 1, "--azimuth-step", 30, "--json").json()
    assert rastered["points"] > 4 and "skylines" in rastered


@pytest.mark.parametrize(
    "arguments, words",
    [
        ((), ("give either --point",)),
        ((*EYES, "--points", "raster:9"), ("give either --point",)),
        (("--points", "a.csv"), ("a.csv", "no such file")),
        (("--points", "some"), ("--points", "raster")),
        (("--point", "0,0"), ("--point", "three finite numbers")),
        ((*EYES, "-o", "a.txt"), ("holds one point",)),
        ((*EYES, "-o", "a.png"), (".png", ".csv")),
        ((*EYES, "--azimuth-step", "7"), ("--azimuth-step", "divide 360")),
    ],
)
def test_bad_arguments(cli, arguments, words):
    cli("skyline", SCENE, *arguments).refused(*words)
