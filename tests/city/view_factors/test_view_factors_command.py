"""``antumbra view-factors``: its outputs and errors. tests/city/view_factors has what the numbers are."""

import csv

import numpy as np
import pytest
import scipy.sparse

import antumbra as at
import radiation_shapes as shapes


@pytest.fixture
def room_obj(tmp_path):
    soup = np.concatenate(shapes.box((2, 3, 4), -1.0))
    lines = [f"v {x:g} {y:g} {z:g}\n" for x, y, z in soup.reshape(-1, 3)]
    lines += [f"f {3 * k + 1} {3 * k + 2} {3 * k + 3}\n" for k in range(len(soup))]
    (tmp_path / "room.obj").write_text("".join(lines))
    return "room.obj"


def test_factors_of_a_room(cli, tmp_path, room_obj):
    options = "--side", "back", "--samples", 100, "--up", "z"
    answer = cli("view-factors", room_obj, *options, "-o", "a.npz", "-o", "a.csv", "--json").json()
    assert (answer["n"], answer["samples"], answer["rays"], answer["factors"]) == (6, 128, 768, 30)
    assert answer["area"] == 52.0 and answer["outputs"] == ["a.npz", "a.csv"]
    found = at.view_factors(tmp_path / room_obj, samples=128, side="back")
    assert (scipy.sparse.load_npz(tmp_path / "a.npz") != found.matrix).nnz == 0
    with open(tmp_path / "a.csv", newline="") as file:
        assert len(list(csv.DictReader(file))) == 30


def test_the_summary(cli, room_obj):
    done = cli("view-factors", room_obj, "--per", "object", "--reciprocal", "--samples", 64, "--up", "z")
    assert done.code == 0 and "0 after" in done.out and "sky" in done.out


def test_something_is_written_or_printed(cli, room_obj):
    done = cli("view-factors", room_obj, "--quiet")
    assert done.code != 0 and "there is nothing to write" in done.err
