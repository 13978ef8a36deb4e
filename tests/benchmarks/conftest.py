"""Fixtures that run the scripts of benchmarks/ as users do, on small scenes."""

import json
import os
import subprocess
import sys
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest

from antumbra.formats.format_registry import write_scene
from antumbra.generate.procedural_scenes import generate

FOLDER = Path(__file__).parents[2] / "benchmarks"
WITHOUT = """
import os, runpy, sys

sys.modules |= dict.fromkeys(sys.argv[1].split(","))  # None: importing it fails, as if it were not installed
sys.argv = sys.argv[2:]
sys.path[0] = os.path.dirname(sys.argv[0])
runpy.run_path(sys.argv[0], run_name="__main__")
"""


class Outcome(NamedTuple):
    out: str
    err: str
    rows: list | dict | None  # rows of the JSON file; None: there is no file

    def skipped(self) -> list[str]:
        """The lines about peers that are not installed."""
        return [line for line in self.err.splitlines() if line.startswith("skipped: ")]


@pytest.fixture
def run(tmp_path):
    """Runs a benchmark that must succeed: run("arrays", scene, "--rounds", 1, without="embreex") -> Outcome."""

    def of(name: str, *arguments, without: str = "", rows: bool = True) -> Outcome:
        found = tmp_path / "rows.json"
        command = [sys.executable, "-c", WITHOUT, without, FOLDER / f"{name}.py", *arguments]
        command += ["--json", found] if rows else []
        settings = {**os.environ, "ANTUMBRA_SCENES": str(tmp_path)}  # no real scenes on any machine
        words = [str(word) for word in command]
        done = subprocess.run(words, capture_output=True, text=True, cwd=tmp_path, env=settings)
        assert done.returncode == 0, done.stderr
        return Outcome(done.stdout, done.stderr, json.loads(found.read_text())["rows"] if rows else None)

    return of


def _told(folder: Path, camera: dict, light: list) -> None:
    (folder / "info.json").write_text(json.dumps({"up": [0, 1, 0], "camera": camera, "light": light}))


@pytest.fixture(scope="session")
def small(tmp_path_factory) -> Path:
    """The file of a scene of a few thousand triangles, in a folder like those of the real scenes: small/scene.glb."""
    folder = tmp_path_factory.mktemp("scenes") / "small"
    folder.mkdir()
    made = generate("atrium", 2000)
    write_scene(made, "small", folder / "scene.glb")
    corner, u, v = (np.array(made.light[k]) for k in ("corner", "u", "v"))
    camera = {k: list(made.camera[k]) for k in ("position", "target")} | {"vfov": made.camera["vfov"]}
    _told(folder, camera, (corner + (u + v) / 2).tolist())
    return folder / "scene.glb"


@pytest.fixture(scope="session")
def moving(tmp_path_factory) -> Path:
    """A folder of vertex frames: a square that moves over a floor."""
    folder = tmp_path_factory.mktemp("scenes") / "moving"
    folder.mkdir()
    square = np.array([[-1, 0, -1], [1, 0, -1], [1, 0, 1], [-1, 0, 1]], np.float32)
    moments = [np.concatenate([4 * square, square + np.float32((k, 1, 0))]) for k in range(3)]
    np.save(folder / "frames.npy", np.stack(moments))
    np.save(folder / "faces.npy", np.array([[2, 1, 0], [3, 2, 0], [6, 5, 4], [7, 6, 4]], np.int32))
    _told(folder, {"position": [0, 6, 0.1], "target": [0, 0, 0], "vfov": 60}, [0, 4, 0])
    info = json.loads((folder / "info.json").read_text())
    (folder / "info.json").write_text(json.dumps({**info, "times": [0.0, 0.5, 1.0]}))
    return folder
