"""The process of xatlas: what it returns, and what the caller sees when it fails."""

import subprocess
import sys

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
