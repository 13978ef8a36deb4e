"""Start-up times: installation, first and second render, first query, and tests after an edit.

python benchmarks/startup.py [--rounds N] [--only CASE ...] [--json FILE]

Each case runs as it does for a user, with its own caches. Cases that install create a new virtual environment in each
round. `wheel`, `clone`, `cold` and `edits` take a minute or more per round.
"""

import argparse
import json
import os
import shutil
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from pathlib import Path

from antumbra.kernels.parallel import thread_count
from common import machine

ROOT = Path(__file__).parents[1]
_NOT_COPIED = shutil.ignore_patterns(".git", ".venv", "__pycache__", "libraries")
OCCLUDED = """
import time
import numpy as np, antumbra as at

scene = at.procedural("atrium", triangles=5_000)
directions = np.random.default_rng(1).normal(size=(1000, 3))
start = time.perf_counter()
blocked = scene.occluded([0.0, 1.5, 0.0], directions, tmax=3.0)
assert 0 < blocked.sum() < 1000
print(time.perf_counter() - start)
"""
EDITS = {
    "picture/shading.py": (
        "tests/picture/test_shading.py",
        "    h, w = face.shape\n",
        "    if len(tints) == -{i}:\n        return\n",
    ),
    "trace/frusta/multi_frusta.py": (
        "tests/trace/frusta/test_tile_group.py",
        "    scratch = Scratch(\n",
        "    if n_samples == -{i}:\n        return\n",
    ),
    "kernels/exact/predicate.py": (
        "tests/kernels/predicate",
        "    side = 0\n",
        "    if i == -{i}:\n        return 0\n",
    ),
}
"""Edited file -> (its tests, a line of a kernel, lines to insert before it that change no result)."""


class Place:
    """The folder of a round, with its own caches."""

    def __init__(self, folder: Path):
        self.folder = folder
        variables = {key: value for key, value in os.environ.items() if not key.startswith(("PYTHON", "VIRTUAL_ENV"))}
        self.environment = variables | {"ANTUMBRA_CACHE": str(folder / "kernels"), "PIP_DISABLE_PIP_VERSION_CHECK": "1"}

    def run(self, *command: str | Path, **more: str) -> str:
        """Run a command in the folder; return its output."""
        done = subprocess.run(
            [str(part) for part in command],
            env=self.environment | more,
            cwd=self.folder,
            capture_output=True,
            text=True,
        )
        if done.returncode:
            raise RuntimeError(f"{' '.join(map(str, command))}\n{done.stdout}{done.stderr}")
        return done.stdout

    def seconds(self, *command: str | Path, **more: str) -> float:
        start = time.perf_counter()
        self.run(*command, **more)
        return time.perf_counter() - start

    def new_environment(self) -> Path:
        """Create a virtual environment; return the folder of its programs."""
        self.run(sys.executable, "-m", "venv", ".venv")
        return self.folder / ".venv" / ("Scripts" if os.name == "nt" else "bin")


def wheel(rounds: int) -> Iterator[tuple[str, float]]:
    """Install the platform wheel, then render. Wheels of other packages come from pip's cache."""
    with tempfile.TemporaryDirectory() as built:
        place = Place(Path(built))
        place.run(
            sys.executable,
            "-m",
            "pip",
            "wheel",
            "-q",
            "--no-deps",
            "-w",
            built,
            ROOT,
            HATCH_BUILD_HOOK_ENABLE_CUSTOM="1",
        )
        (file,) = Path(built).glob("*.whl")
        yield "size of the platform wheel, MB", file.stat().st_size / 1e6
        for _ in range(rounds):
            with tempfile.TemporaryDirectory() as folder:
                place = Place(Path(folder))
                programs = place.new_environment()
                start = time.perf_counter()
                place.run(programs / "pip", "install", "-q", file)
                installed = time.perf_counter() - start
                first = place.seconds(programs / "antumbra", "render")
                yield "platform wheel: pip install", installed
                yield "platform wheel: first render", first
                yield "platform wheel: second render", place.seconds(programs / "antumbra", "render")


def clone(rounds: int) -> Iterator[tuple[str, float]]:
    """The README's first command in a clone, with empty caches, including pip's; then a second render."""
    for _ in range(rounds):
        with tempfile.TemporaryDirectory() as folder:
            place = Place(Path(folder))
            shutil.copytree(ROOT, place.folder, dirs_exist_ok=True, ignore=_NOT_COPIED)
            python, empty = shutil.which("python3") or sys.executable, {"PIP_CACHE_DIR": str(place.folder / "pip")}
            start = time.perf_counter()
            place.run(python, "-m", "venv", ".venv")
            place.run(".venv/bin/pip", "install", ".[jit]", **empty)
            installed = time.perf_counter() - start
            first = place.seconds(".venv/bin/antumbra", "render")
            yield "clone, empty caches: venv and pip install .[jit]", installed
            yield "clone, empty caches: first render, compiling", first
            yield "clone, empty caches: together", installed + first
            yield "clone: second render", place.seconds(".venv/bin/antumbra", "render")


def here(rounds: int) -> Iterator[tuple[str, float]]:
    """Start-up in this environment, with the user's kernel cache."""
    with tempfile.TemporaryDirectory() as folder:
        place = Place(Path(folder))
        place.environment = {key: value for key, value in os.environ.items() if key != "PYTHONDONTWRITEBYTECODE"}
        render = sys.executable, "-m", "antumbra", "render"
        place.run(*render)
        place.run(sys.executable, "-c", OCCLUDED)
        for _ in range(rounds):
            yield "python -c pass", place.seconds(sys.executable, "-c", "pass")
            yield "import antumbra", place.seconds(sys.executable, "-c", "import antumbra")
            yield "antumbra --help", place.seconds(sys.executable, "-m", "antumbra", "--help")
            yield "second render", place.seconds(*render)
            yield "first scene.occluded, 1000 rays", float(place.run(sys.executable, "-c", OCCLUDED))


def cold(rounds: int) -> Iterator[tuple[str, float]]:
    """The first render in this environment, without shipped kernels and with an empty cache."""
    for _ in range(rounds):
        with tempfile.TemporaryDirectory() as folder:
            yield (
                "first render, nothing shipped",
                Place(Path(folder)).seconds(sys.executable, "-m", "antumbra", "render"),
            )


def edits(rounds: int) -> Iterator[tuple[str, float]]:
    """Rerun the tests of a file after an edit."""
    with tempfile.TemporaryDirectory() as folder:
        place = Place(Path(folder))
        shutil.copytree(ROOT, place.folder, dirs_exist_ok=True, ignore=_NOT_COPIED)
        paths = {"PYTHONPATH": str(place.folder / "src")}
        for file, (tests, line, more) in EDITS.items():
            command = sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", tests
            place.run(*command, **paths)
            path = place.folder / "src" / "antumbra" / file
            text = path.read_text()
            for i in range(1, rounds + 1):
                path.write_text(text.replace(line, more.format(i=i) + line, 1))
                yield f"tests again after an edit of {file}", place.seconds(*command, **paths)
            path.write_text(text)


CASES: dict[str, Callable[[int], Iterator[tuple[str, float]]]] = {
    "here": here,
    "cold": cold,
    "wheel": wheel,
    "clone": clone,
    "edits": edits,
}


def main(arguments: list[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument("--only", nargs="+", choices=CASES, default=list(CASES))
    parser.add_argument("--json", type=Path)
    options = parser.parse_args(arguments)
    rows: dict[str, list[float]] = {}
    for case in options.only:
        for name, value in CASES[case](options.rounds):
            rows.setdefault(name, []).append(value)
            print(f"{name:60} {value:7.2f}", flush=True)
    print(f"\n{'':60}  median    best     of")
    for name, values in rows.items():
        print(f"{name:60} {statistics.median(values):7.2f} {min(values):7.2f} {len(values):6}")
    if options.json:
        options.json.write_text(json.dumps({"machine": machine(thread_count(None)), "rows": rows}, indent=1))


if __name__ == "__main__":
    main()
