"""Versions, commit and hardware, for the header of results."""

import os
import platform
import subprocess
from importlib.metadata import version
from pathlib import Path

from ..version import VERSION as __version__


def about() -> dict[str, str | int]:
    """Name -> version, commit, or part of the machine. `commit` is there only in a checkout of git."""
    found: dict[str, str | int] = {"antumbra": __version__}
    if commit := _commit():
        found["commit"] = commit
    found |= {"python": platform.python_version(), "numpy": version("numpy"), "numba": version("numba")}
    return found | {"system": f"{platform.system()} {platform.release()}", **_machine()}


def _machine() -> dict[str, str | int]:
    import llvmlite.binding as llvm

    from ..kernels.parallel import thread_count
    from ..kernels.processor import level

    processor = f"{_model() or platform.machine()} ({llvm.get_host_cpu_name()}, kernels for {level()})"
    return {"processor": processor, "cores": thread_count(None), **_memory()}


def _model() -> str:
    """The processor's name by its maker, if the system tells it."""
    try:
        lines = Path("/proc/cpuinfo").read_text().splitlines()
    except OSError:
        return platform.processor()
    return next((line.partition(":")[2].strip() for line in lines if line.startswith("model name")), "")


def _memory() -> dict[str, str]:
    try:
        size = os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE")
    except (AttributeError, OSError, ValueError):  # not on Windows
        return {}
    return {"memory": f"{size / 2**30:.0f} GiB"}


def _commit() -> str:
    """The commit of this file, with "-dirty" if files have changed since; empty if git does not know the file."""
    file = Path(__file__)
    if not _git(file.parent, "ls-files", file.name):
        return ""
    return _git(file.parent, "describe", "--always", "--dirty", "--abbrev=12", "--exclude=*")


def _git(folder: Path, *words: str) -> str:
    settings = {**os.environ, "GIT_OPTIONAL_LOCKS": "0"}
    try:
        done = subprocess.run(
            ["git", "-C", str(folder), *words], env=settings, capture_output=True, text=True, timeout=10
        )
    except (OSError, subprocess.TimeoutExpired):
        return ""
    return done.stdout.strip() if done.returncode == 0 else ""
