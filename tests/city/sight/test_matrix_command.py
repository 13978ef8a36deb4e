"""`antumbra matrix`."""

import csv
from pathlib import Path

import numpy as np
import pytest
import scipy.sparse

import antumbra as at
from antumbra.city.tables.bit_matrices import unpack_bits
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
