"""An animation that is killed while it writes leaves a hidden file. The same command continues and removes the file."""

import json
import os
import signal
import subprocess
import sys

import pytest
from PIL import Image

SCRIPT = """
import os, signal, sys
from antumbra.cli import main
from antumbra.image import save

write, seen = save._write_png, 0

def killed(*arguments):
    # The process sends the signal to itself, so that nothing depends on how fast it is.
    global seen
    write(*arguments)
    seen += 1
    if seen == 2:
        os.kill(os.getpid(), signal.SIGKILL)

save._write_png = killed
sys.exit(main(sys.argv[1:]))
"""
COMMAND = ["render", "procedural:atrium?triangles=2000", "--size", "24", "--spp", "4", "--frames", "0:3"]
COMMAND += ["-o", "f.##.png", "--json"]


def run(folder, *words):
    return subprocess.run([sys.executable, *words, *COMMAND], capture_output=True, text=True, cwd=folder)


@pytest.mark.skipif(sys.platform == "win32", reason="signals are different on Windows")
def test_killed(tmp_path):
    assert run(tmp_path, "-c", SCRIPT).returncode == -signal.SIGKILL
    lock, picture, first = sorted(os.listdir(tmp_path))
    assert first == "f.00.png" and {lock[-5:], picture[-4:]} == {".lock", ".tmp"} and lock[:-5] == picture[:-4]
    done = run(tmp_path, "-m", "antumbra")
    assert done.returncode == 0, done.stderr
    states = [json.loads(line).get("state") for line in done.stdout.splitlines()]
    assert states == ["finished", "rendered", "rendered", "rendered", None]
    assert sorted(os.listdir(tmp_path)) == [f"f.0{k}.png" for k in range(4)]
    for k in range(4):
        with Image.open(tmp_path / f"f.0{k}.png") as image:
            image.load()
            assert image.size == (24, 24)
