"""An unfinished build leaves nothing that opens, and parts from which the same command resumes."""

import os
import signal
import subprocess
import sys
from types import SimpleNamespace

import pytest

import antumbra as at
from antumbra.engine.store_building import build_store
from antumbra.store.store_file import open_store
from bvh_scenes import scattered
from stores import soup_scene

POSIX = pytest.mark.skipif(sys.platform == "win32", reason="signals are different on Windows")
SCRIPT = """
import os, signal, sys
from antumbra.cli import main
from antumbra.cli.console import ProgressDisplay

signal.signal(signal.SIGINT, signal.default_int_handler)  # it is ignored where a shell started this in the background
phase, name = sys.argv[1:3]
seen = 0

def say(self, text, done=0, total=0):
    # The process sends the signal to itself, so that nothing depends on how fast it is.
    global seen
    seen += text == phase
    if text == phase and seen == 2:
        os.kill(os.getpid(), getattr(signal, name))

ProgressDisplay.say = say
sys.exit(main(sys.argv[3:]))
"""
COMMAND = ["build", "procedural:city?triangles=150k", "-o", "a.antumbra", "--max-memory", "384M"]


def interrupted(folder, phase, name):
    return run(folder, "-c", SCRIPT, phase, name)


def run(folder, *words):
    return subprocess.run([sys.executable, *words, *COMMAND], capture_output=True, text=True, cwd=folder)


@POSIX
@pytest.mark.parametrize("phase, name", [("reading", "SIGKILL"), ("building", "SIGKILL"), ("building", "SIGTERM")])
def test_killed(tmp_path, phase, name):
    assert interrupted(tmp_path, phase, name).returncode == -getattr(signal, name)
    assert os.listdir(tmp_path) == ["a.parts"]
    records = list((tmp_path / "a.parts").rglob("*.npz"))
    assert len(records) == (2 if phase == "building" else 0)
    for path in tmp_path.rglob("*.*"):
        if path.is_file():
            with pytest.raises(at.InputError, match=r"not finished|empty|not a store"):
                open_store(path)
    again = run(tmp_path, "-m", "antumbra")
    assert again.returncode == 0, again.stderr
    assert os.listdir(tmp_path) == ["a.antumbra"]
    store = open_store(tmp_path / "a.antumbra")
    assert len(store) > 1 and 100_000 < store.n_triangles == store.chunks.triangles.sum()
    for k in range(len(store)):
        store.check(k)


@POSIX
@pytest.mark.parametrize("phase", ["reading", "building"])
def test_control_c(tmp_path, phase):
    (tmp_path / "a.antumbra").write_bytes(b"older")
    done = interrupted(tmp_path, phase, "SIGINT")
    assert (done.returncode, done.stdout) == (130, "")
    *notes, last = [line for line in done.stderr.splitlines() if "compiling" not in line]
    assert last == "antumbra: interrupted" and len(notes) <= (phase == "building")
    assert all("parts are done; run it again to resume from there" in note for note in notes)
    assert sorted(os.listdir(tmp_path)) == ["a.antumbra", *(["a.parts"] * (phase == "building"))]
    assert (tmp_path / "a.antumbra").read_bytes() == b"older"


@pytest.mark.parametrize("room", [10_000, 300_000, 900_000])
def test_a_full_disk(tmp_path, room):
    resource = pytest.importorskip("resource", reason="no RLIMIT_FSIZE on this system")
    scene = soup_scene(scattered(20_000))  # 720 kB of vertices, and a store of more
    build_store([scene], tmp_path / "b.antumbra", chunk=1024)  # this also compiles the kernels
    (tmp_path / "b.antumbra").unlink()
    limits = resource.getrlimit(resource.RLIMIT_FSIZE)
    handler = signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
    resource.setrlimit(resource.RLIMIT_FSIZE, (room, limits[1]))
    try:
        with pytest.raises(at.InputError, match=r"a.antumbra: cannot be written .*; choose another place") as caught:
            build_store([scene], tmp_path / "a.antumbra", chunk=1024)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limits)
        signal.signal(signal.SIGXFSZ, handler)
    assert "\n" not in str(caught.value) and os.listdir(tmp_path) == []


def test_a_disk_without_room(tmp_path, monkeypatch):
    """A build asks for free space before it begins."""
    monkeypatch.setattr("shutil.disk_usage", lambda _: SimpleNamespace(free=3_000_000))
    with pytest.raises(at.InputError, match=r"a.antumbra: 50,000 triangles take .* has 0.0 GB left; free some"):
        build_store([soup_scene(scattered(50_000))], tmp_path / "a.antumbra")
    build_store([soup_scene(scattered(20_000))], tmp_path / "a.antumbra")
    assert os.listdir(tmp_path) == ["a.antumbra"]


def test_the_header_comes_last(tmp_path, monkeypatch):
    """A file without the last write is no store, although all other bytes are complete."""
    states = []

    def sync(descriptor):
        states.extend(path.read_bytes() for path in tmp_path.glob(".antumbra-*.tmp") if path.is_file())

    monkeypatch.setattr(os, "fsync", sync)
    build_store([soup_scene(scattered(2000))], tmp_path / "a.antumbra", chunk=256)
    before, after = states
    assert len(before) == len(after) and before[4096:] == after[4096:] and not any(before[:4096])
    (tmp_path / "b.antumbra").write_bytes(before)
    with pytest.raises(at.InputError, match="not finished"):
        open_store(tmp_path / "b.antumbra")
    open_store(tmp_path / "a.antumbra").check(0)
