"""The machine and the versions that measured something."""

import os
import platform
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path


def machine(threads: int) -> dict[str, str | int]:
    """Hardware and versions, by name."""
    from .. import __version__
    from ..kernels.processor import level

    return {
        "processor": _processor(),
        "level": level(),
        "cores": os.cpu_count() or 1,
        "threads": threads,
        "system": platform.platform(terse=True),
        "antumbra": __version__,
        "python": platform.python_version(),
        **{name: _version(name) for name in ("numpy", "numba")},
    }


def _version(package: str) -> str:
    try:
        return version(package)
    except PackageNotFoundError:
        return "unknown"


def _processor() -> str:
    """The model name, or at least the kind of processor."""
    try:
        lines = Path("/proc/cpuinfo").read_text(errors="replace").splitlines()
    except OSError:
        lines = []
    names = (line.partition(":")[2].strip() for line in lines if line.startswith("model name"))
    return next(names, "") or platform.processor() or platform.machine()
