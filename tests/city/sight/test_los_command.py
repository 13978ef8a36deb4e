"""`antumbra los`."""

import csv
from pathlib import Path

import numpy as np
import pytest

from command_line import TRIANGLES

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
        (("--from", "0,0,0", "--to", "1,1,1", "--to", "2,2,2", "--pairs", "zip"), ["1 observer and 2 targets"]),
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
