"""Films on the command line: whole or not at all, and continued after an interruption."""

import json
import os
from itertools import pairwise

import numpy as np
import pytest
from PIL import Image

from antumbra.picture import image_files
from gltf_files import TETRAHEDRON, TETRAHEDRON_FACES, single


@pytest.fixture
def moving(tmp_path):
    made = single(TETRAHEDRON, TETRAHEDRON_FACES)
    made.animate(0, "translation", [0, 1], [[0, 0, 0], [2, 0, 0]])
    made.write(tmp_path)
    return ["render", "made.glb", "--size", "33x25", "--spp", "1", "--frames", "0:4", "--fps", "5"]


def test_a_film(cli, moving, tmp_path):
    done = cli(*moving, "-o", "a.gif")
    assert done.code == 0 and "film" in done.out and "1 s" in done.out
    assert sorted(os.listdir(tmp_path)) == ["a.gif", "made.glb"]
    with Image.open(tmp_path / "a.gif") as film:
        assert film.n_frames == 5 and film.size == (33, 25)
        shown = [np.asarray(film.convert("RGB")) for k in range(5) if film.seek(k) is None]
    assert all((a != b).any() for a, b in pairwise(shown))


def test_an_mp4_at_the_speed_of_the_scene(cli, moving, tmp_path):
    import imageio_ffmpeg

    moving[moving.index("0:4")] = "0:4:2"
    told = [json.loads(line) for line in cli(*moving, "-o", "a.mp4", "--json").out.splitlines()]
    assert told[-1]["output"] == "a.mp4" and told[-1]["rendered"] == [0, 2, 4]
    reader = imageio_ffmpeg.read_frames(str(tmp_path / "a.mp4"))
    found = next(reader)
    assert found["fps"] == 2.5 and tuple(found["size"]) == (34, 26) and len(list(reader)) == 3
    assert sorted(os.listdir(tmp_path)) == ["a.mp4", "made.glb"]


def test_an_interrupted_film_goes_on_with_its_frames(cli, moving, tmp_path, monkeypatch):
    write, seen = image_files.write_png, []

    def stopped(*arguments):
        seen.append(1)
        if len(seen) == 3:
            raise KeyboardInterrupt
        write(*arguments)

    monkeypatch.setattr(image_files, "write_png", stopped)
    assert cli(*moving, "-o", "a.gif").code not in (0, 2)
    assert sorted(os.listdir(tmp_path)) == ["a.gif.frames", "made.glb"]
    assert sorted(os.listdir(tmp_path / "a.gif.frames")) == ["000000.png", "000001.png"]
    monkeypatch.undo()
    monkeypatch.chdir(tmp_path)
    told = [json.loads(line) for line in cli(*moving, "-o", "a.gif", "--json").out.splitlines()]
    assert (told[-1]["finished"], told[-1]["rendered"]) == ([0, 1], [2, 3, 4])
    assert sorted(os.listdir(tmp_path)) == ["a.gif", "made.glb"]


def test_a_failed_frame_makes_no_film(cli, moving, tmp_path, monkeypatch):
    write, seen = image_files.write_png, []

    def full(*arguments):
        seen.append(1)
        if len(seen) == 3:
            raise OSError(28, "No space left on device")
        write(*arguments)

    monkeypatch.setattr(image_files, "write_png", full)
    done = cli(*moving, "-o", "a.gif")
    assert done.code == 2 and "No space" in done.err and "not written" in done.out
    assert sorted(os.listdir(tmp_path)) == ["a.gif.frames", "made.glb"]


@pytest.mark.parametrize(
    "more, says",
    [
        (["--background", "transparent", "-o", "a.gif"], ["transparent", "no alpha"]),
        (["-o", "there/a.gif"], ["there"]),
        (["-o", "a.avi"], ["avi"]),
    ],
)
def test_films_that_cannot_be(cli, moving, tmp_path, more, says):
    cli(*moving, *more).refused(*says)
    assert os.listdir(tmp_path) == ["made.glb"]


def test_a_film_needs_frames(cli, moving, tmp_path):
    cli("render", "made.glb", "-o", "a.gif").refused("--frames FIRST:LAST")
    cli("render", "missing.glb", "--frames", "0:3", "-o", "a.gif").refused("missing.glb")
    assert os.listdir(tmp_path) == ["made.glb"]
