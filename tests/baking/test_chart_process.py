"""The process of xatlas: what it returns, and what the caller sees when it fails."""

import os
import signal
import subprocess
import sys
import time

import numpy as np
import pytest

import antumbra as at
from antumbra.baking import chart_process
from antumbra.baking.chart_process import charts_of
from baked_files import box, grid, scene_file

pytest.importorskip("xatlas")


def test_meshes_come_back_in_their_order():
    meshes = [box((0, 0, 0), (1, 2, 3)), grid([0.0, 1.0, 2.0], [0.0, 1.0])]
    for (vertices, faces), chart in zip(meshes, charts_of(meshes, 64, 4), strict=True):
        np.testing.assert_array_equal(chart.source[chart.faces], faces)
        assert chart.uv.min() >= 0.0 and chart.uv.max() <= 1.0 and chart.source.max() == len(vertices) - 1


@pytest.mark.parametrize(
    "program, reason",
    [
        ("import os, signal; os.kill(os.getpid(), signal.SIGSEGV)", "ended with SIGSEGV"),
        ("raise ValueError('too large')", "ValueError: too large"),
        ("import os; os._exit(3)", "exit code 3"),
        ("pass", "exit code 0"),
        ("raise MemoryError", "memory ran out"),
        ("import os, signal; os.kill(os.getpid(), signal.SIGKILL)", "memory ran out"),
    ],
)
@pytest.mark.skipif(sys.platform == "win32", reason="signals of POSIX")
def test_a_crash_is_one_line_with_a_remedy(tmp_path, monkeypatch, cli, program, reason):
    monkeypatch.setattr(chart_process, "_START", program)
    path = scene_file(tmp_path, grid([0.0, 1.0], [0.0, 1.0]))
    with pytest.raises(at.InputError, match=reason) as caught:
        at.bake(path, tmp_path / "out.glb", texture=64)
    assert "\n" not in str(caught.value) and "uv" in str(caught.value)
    assert cli("bake", path, "-o", "out.glb", "--texture", "64").code == 2
    assert not (tmp_path / "out.glb").exists()


_LITTLE_MEMORY = """
import json, sys, resource
sys.path[:] = json.loads(sys.stdin.readline())
import xatlas
from antumbra.baking.chart_process import serve
now = int(open("/proc/self/statm").read().split()[0]) * resource.getpagesize()
resource.setrlimit(resource.RLIMIT_AS, (now + (1 << 24), now + (1 << 24)))
serve(json.loads(sys.stdin.readline()))
"""


@pytest.mark.skipif(sys.platform != "linux", reason="limits of memory, and /proc")
def test_exhausted_memory_is_one_line(monkeypatch):
    monkeypatch.setattr(chart_process, "_START", _LITTLE_MEMORY)
    x = np.linspace(0.0, 1.0, 400)
    with pytest.raises(at.InputError, match=r"cannot unwrap these surfaces \((memory ran out|.* SIG\w+)\); bake into"):
        charts_of([grid(x, x)], 64, 4)


@pytest.mark.skipif(sys.platform == "win32", reason="signals of POSIX")
def test_a_process_that_hangs_ends_with_the_command(tmp_path):
    """Ctrl-C in a terminal signals the command and the process of xatlas, which ignores it."""
    path = scene_file(tmp_path, grid([0.0, 1.0], [0.0, 1.0]))
    begun = str(tmp_path / "begun")
    hangs = f"""
import fcntl, signal, time
signal.signal(signal.SIGINT, signal.SIG_IGN)
begun = open({begun!r}, "w")
fcntl.flock(begun, fcntl.LOCK_EX)
time.sleep(100)
"""
    program = f"""
import sys
from antumbra.baking import chart_process
chart_process._START = {hangs!r}
from antumbra.cli import main
sys.exit(main(["bake", {str(path)!r}, "-o", {str(tmp_path / "out.glb")!r}, "--texture", "64"]))
"""
    command = subprocess.Popen([sys.executable, "-c", program], start_new_session=True, stderr=subprocess.PIPE)
    while not (tmp_path / "begun").exists():
        assert command.poll() is None, command.stderr.read()
        time.sleep(0.05)
    os.killpg(command.pid, signal.SIGINT)
    _, errors = command.communicate(timeout=60)
    assert command.returncode == 130 and b"Traceback" not in errors and not (tmp_path / "out.glb").exists()
    _wait_for_unlock(begun)


def _wait_for_unlock(path):
    """Wait for the end of the process that locked a file; an entry of the process table may outlive it."""
    import fcntl

    with open(path) as file:
        for _ in range(400):
            try:
                return fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except BlockingIOError:
                time.sleep(0.05)
    pytest.fail("the process of xatlas goes on after its command has ended")


def test_ctrl_c_ends_the_process_and_removes_its_files(tmp_path, monkeypatch):
    started = []

    class Interrupted(subprocess.Popen):
        def communicate(self, *args, **keywords):
            started.append(self)
            raise KeyboardInterrupt

    monkeypatch.setattr(chart_process, "_START", "import time; time.sleep(60)")
    monkeypatch.setattr(subprocess, "Popen", Interrupted)
    monkeypatch.setenv("TMPDIR", str(tmp_path))
    monkeypatch.setattr("tempfile.tempdir", None)
    with pytest.raises(KeyboardInterrupt):
        charts_of([grid([0.0, 1.0], [0.0, 1.0])], 64, 4)
    assert len(started) == 1 and started[0].poll() is not None and not list(tmp_path.iterdir())
