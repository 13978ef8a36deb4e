"""Builds of `scripts/release`: the sdist, and from it the pure wheel and one wheel for each system.

Wheels are built from the unpacked sdist, so the sdist is known to be complete. Kernels for all systems are compiled in
one run, because Numba's part of the work is the same for all of them; each wheel then takes them from the cache.
"""

import os
import subprocess
import sys
import tarfile
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from types import ModuleType
from typing import NamedTuple

ROOT = Path(__file__).resolve().parents[1]


class ReleaseError(Exception):
    """A release cannot be made: one line that names the problem, and the output of the tool that reported it."""

    def __init__(self, line: str, output: str = ""):
        super().__init__(line)
        self.output = output


class Source(NamedTuple):
    """What a release is built from."""

    root: Path  # folder with pyproject.toml
    version: str
    epoch: int  # SOURCE_DATE_EPOCH: the time of all files in archives


class Package(NamedTuple):
    """A file for PyPI."""

    path: Path
    system: str | None = None  # that a wheel is for; None: the sdist and the pure wheel


def run(command: list[str | Path], what: str, cwd: Path | None = None, env: dict[str, str] | None = None) -> str:
    """Standard output of a command. Raises ReleaseError with its last line if it fails."""
    done = subprocess.run([str(word) for word in command], cwd=cwd, env=env, capture_output=True, text=True)
    if done.returncode:
        output = done.stdout + done.stderr
        last = next((line.strip() for line in reversed(output.splitlines()) if line.strip()), "no output")
        raise ReleaseError(f"{what} failed with exit code {done.returncode}: {last}", output)
    return done.stdout


# --- Sources ----------------------------------------------------------------------------------------------------------


def read_version(root: Path) -> str:
    """The version of the package in a folder."""
    scope: dict[str, str] = {}
    exec((root / "src" / "antumbra" / "version.py").read_text(encoding="utf-8"), scope)
    return scope["VERSION"]


def read_source(root: Path, allow_dirty: bool) -> Source:
    """The working tree as a source. Raises ReleaseError if it differs from the commit, unless that is allowed."""
    changed = run(["git", "status", "--porcelain"], "git status", root).splitlines()
    if changed and not allow_dirty:
        more = f" and {len(changed) - 1} more" if len(changed) > 1 else ""
        raise ReleaseError(f"the tree differs from its commit ({changed[0].strip()}{more}); commit, or pass --dirty")
    epoch = os.environ.get("SOURCE_DATE_EPOCH") or run(["git", "log", "-1", "--format=%ct"], "git log", root)
    return Source(root, read_version(root), int(epoch))


def unpack(sdist: Path, folder: Path, source: Source) -> Source:
    """The contents of an sdist as a source."""
    with tarfile.open(sdist) as archive:
        archive.extractall(folder, filter="data")
    return source._replace(root=folder / sdist.name.removesuffix(".tar.gz"))


# --- Archives ---------------------------------------------------------------------------------------------------------


def build_hook() -> ModuleType:
    """`scripts/hatch_build.py`, which owns the tags of wheels."""
    import hatch_build

    return hatch_build


def environment_of(source: Source, **settings: str) -> dict[str, str]:
    """This process's variables without those that affect builds, and with settings."""
    ours = "HATCH_", "ANTUMBRA_SYSTEM", "ANTUMBRA_LEVEL", "PYTHON"
    env = {name: value for name, value in os.environ.items() if not name.startswith(ours)}
    fixed = {"SOURCE_DATE_EPOCH": str(source.epoch), "PYTHONDONTWRITEBYTECODE": "1", "PYTHONHASHSEED": "0"}
    return env | fixed | settings


def _build(source: Source, kind: str, out: Path, env: dict[str, str]) -> Path:
    """Build one archive into a folder of its own, and return its path."""
    out.mkdir(parents=True)
    run(
        [sys.executable, "-m", "hatchling", "build", "-t", kind, "-d", out],
        f"the build of {out.name}",
        source.root,
        env,
    )
    (path,) = out.iterdir()
    return path


def build_sdist(source: Source, out: Path) -> Package:
    """Build the sdist into `out`, a new folder."""
    return Package(_build(source, "sdist", out, environment_of(source)))


def build_wheel(source: Source, out: Path, system: str | None = None) -> Package:
    """Build a wheel into `out`, a new folder; `system`: with its kernel libraries."""
    hook = {} if system is None else {"HATCH_BUILD_HOOK_ENABLE_CUSTOM": "1", "ANTUMBRA_SYSTEM": system}
    return Package(_build(source, "wheel", out, environment_of(source, **hook)), system)


def compile_kernels(source: Source, systems: list[str]) -> None:
    """Compile all kernels for some systems, and those of pages, into the user's cache, on all cores."""
    program = (
        "import sys; from antumbra.kernels.toolchain.library_build import compile_for; compile_for(sys.argv[1:]); "
        "from antumbra.web.kernel_linking import linked_module; linked_module()"
    )
    env = environment_of(source, PYTHONPATH=str(source.root / "src"))
    run([sys.executable, "-c", program, *systems], "compiling kernels", env=env)


def build_wheels(source: Source, out: Path, systems: list[str]) -> list[Package]:
    """Build the wheels of some systems, several at a time, each into a folder of its own in `out`."""
    with ThreadPoolExecutor(os.cpu_count()) as threads:
        return list(threads.map(lambda system: build_wheel(source, out / system, system), systems))
