"""What every command prints about one of each thing: singular nouns, verbs that agree, and rounded numbers.

The scene is a triangle, and there is one sensor, observer, target, module, frame, sample and pixel.
"""

import re

import pytest

from antumbra.base.command_registry import COMMANDS

TRIANGLE = "v 0 0 0\nv 10 0 0\nv 0 10 0\nf 1 2 3\n"
PLACE = ("--latitude", 52.1, "--longitude", 4.3, "--days", "2026-06-21")
POINT = ("--point", "1,1,-0.000293435454864213")
EYE, FOOT = "1,1,-0.000293435454864213", "2,2,1.7000000001"
PICTURE = ("--size", "1x1", "--spp", 1)

ONE_OF_EACH = {
    "render": (*PICTURE, "-o", "a.png"),
    "bake": ("-o", "a.glb"),
    "dataset": ("--random", 1, "--size", "8x8", "-o", "frames"),
    "page": ("-o", "a.html"),
    "sun": (*PLACE, "--step", 720, "--sensors", "p.csv", "-o", "a.csv"),
    "shadow": (*PLACE[:4], "--at", "2026-06-21T15:00", "-o", "a.geojson"),
    "calendar": (*PLACE, "--step", 60, *POINT, "-o", "a.csv"),
    "route": (*PLACE, "--step", 60, "--line", "line.csv", "--spacing", 1, "-o", "a.csv"),
    "pv": (*PLACE, "--step", 720, "--modules", "modules.csv", "-o", "a.csv"),
    "skyline": (*POINT, "-o", "a.csv"),
    "viewshed": ("--observer", EYE, "-o", "a.csv"),
    "visible": ("--points", "p.csv", "-o", "a.csv"),
    "los": ("--from", EYE, "--to", FOOT, "-o", "a.csv"),
    "matrix": ("--sensors", "p.csv", "--targets", "p.csv", "-o", "a.npy"),
    "view-factors": ("--samples", 64, "-o", "a.csv"),
    "info": (),
    "build": ("-o", "a.antumbra"),
    "compare": (*PICTURE, "--plan", "bsah+single", "--plan", "lbvh+single", "--rounds", 1),
    "explain": (*PICTURE, "-o", "a.png"),
    "culling": (*PICTURE, "-o", "a.png"),
}

WITHOUT_A_SCENE = {"view", "merge", "scenes", "formats", "doctor", "warmup", "plans"}

PLURAL = re.compile(r"(?<![\d.,/x-])1 ((?:more |open |view |shadow )?[a-z]+s)\b(?! \()")
SINGULAR_IN_S = {"axis", "class", "glass", "is", "was", "has", "lies", "bus", "ms", "us"}
LONG = re.compile(r"(?<![\w.])-?\d*\.0*[1-9]\d{6,}")
PLURAL_VERB = re.compile(r"\b1(?: of \d+)? [a-z]+ (?:lie|have|are|take|lack|need|block|repeat|see)\b")


def faults(text: str) -> list[str]:
    """The parts of a text that a technical writer would correct."""
    found = [match[0] for match in PLURAL.finditer(text) if match[1].split()[-1] not in SINGULAR_IN_S]
    found += [match[0] for pattern in (LONG, PLURAL_VERB) for match in pattern.finditer(text)]
    return found + re.findall(r"\bNone\b|(?<![\w.,])-0(?:\.0+)?(?![\d.])|\bnan\b", text)


def test_the_faults_are_found() -> None:
    text = "1 points, 1 of 1 observers, 1 of 2 observers lie on it, None, -0, is -0.00, at 1,1,-0.000293435454864213"
    assert faults(text) == [
        "1 points",
        "1 observers",
        "-0.000293435454864213",
        "1 of 2 observers lie",
        "None",
        "-0",
        "-0.00",
    ]
    assert faults("1 point, 1.1 points, 21 rays, 1 of 2 observers lies, -0.5, 0-0, 2026-06-21, 1x1, 1 axis") == []


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A triangle, a point, a line and a module."""
    path = tmp_path_factory.mktemp("one")
    (path / "one.obj").write_text(TRIANGLE)
    (path / "p.csv").write_text(f"id,x,y,z\na,{EYE}\n")
    (path / "line.csv").write_text("x,y,z\n-1,1,1\n-1,1.5,1\n")
    (path / "modules.csv").write_text("id,x,y,z,width,height,azimuth,tilt\na,2,2,1,1,1,180,30\n")
    return path


def test_every_command_about_a_scene_is_tried() -> None:
    assert set(ONE_OF_EACH) | WITHOUT_A_SCENE == set(COMMANDS)


@pytest.mark.parametrize("name", ONE_OF_EACH)
def test_a_report_of_one_thing_is_in_the_singular_and_rounded(name, cli, folder, monkeypatch) -> None:
    monkeypatch.chdir(folder)
    up = () if name == "info" else ("--up", "z")
    done = cli(name, "one.obj", *up, *ONE_OF_EACH[name])
    assert done.code == 0, done.err
    assert faults(done.out + done.err) == [], done.out + done.err
