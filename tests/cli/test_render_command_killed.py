"""An animation that is killed while it writes leaves a hidden file. The same command continues and removes the file."""

import json
import os
import sys

import pytest
from PIL import Image

from killed import run, run_killed

COMMAND = ["render", "procedural:atrium?triangles=2000", "--size", "24", "--spp", "4", "--frames", "0:3"]
COMMAND += ["-o", "f.##.png", "--json"]


@pytest.mark.skipif(sys.platform == "win32", reason="signals are different on Windows")
def test_killed(tmp_path):
    run_killed(tmp_path, "write_png", *COMMAND)
    lock, picture, first = sorted(os.listdir(tmp_path))
    assert first == "f.00.png" and {lock[-5:], picture[-4:]} == {".lock", ".tmp"} and lock[:-5] == picture[:-4]
    done = run(tmp_path, *COMMAND)
    assert done.returncode == 0, done.stderr
    states = [json.loads(line).get("state") for line in done.stdout.splitlines()]
    assert states == ["finished", "rendered", "rendered", "rendered", None]
    assert sorted(os.listdir(tmp_path)) == [f"f.0{k}.png" for k in range(4)]
    for k in range(4):
        with Image.open(tmp_path / f"f.0{k}.png") as image:
            image.load()
            assert image.size == (24, 24)
