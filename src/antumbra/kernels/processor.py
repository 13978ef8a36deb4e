"""Processor levels: names for the instructions that machine code may use.

`x86-64-v2`, `-v3` (AVX2, FMA) and `-v4` (AVX-512) are the levels of the x86-64 psABI. `aarch64` has NEON. The default
is the best level of this processor; ``ANTUMBRA_LEVEL`` selects another.

Kernel libraries (`toolchain.kernel_library`) contain a function that reads the features of the processor, so the level
is known without LLVM where there is a library.
"""

import ctypes
import os
import platform
import sys
from contextlib import suppress
from functools import cache
from importlib.util import find_spec
from pathlib import Path

from ..base.errors import InputError

_V2 = ["cx16", "sahf", "popcnt", "sse3", "ssse3", "sse4.1", "sse4.2"]
_V3 = [*_V2, *["avx", "avx2", "bmi", "bmi2", "f16c", "fma", "lzcnt", "movbe", "xsave"]]
_V4 = [*_V3, *["avx512f", "avx512bw", "avx512cd", "avx512dq", "avx512vl"]]
X86 = {"x86-64-v2": _V2, "x86-64-v3": _V3, "x86-64-v4": _V4}
"""Features of each level, by LLVM's names. The name of a level is also LLVM's name of a processor."""

LEVELS = (*X86, "aarch64")
OTHER = "generic"
"""The level of all other machines: LLVM's generic processor."""

LIBRARIES = Path(__file__).parent / "libraries"
"""The folder of the kernel libraries in an installed package."""

SUFFIXES = {"linux": ".so", "darwin": ".dylib", "win32": ".dll"}
"""Suffixes of shared libraries, by `sys.platform`."""


@cache
def level() -> str:
    """The level that kernels are compiled for on this machine."""
    name = os.environ.get("ANTUMBRA_LEVEL")
    best = _best()
    if not name:
        return best
    if name not in usable(best):
        raise InputError(f"ANTUMBRA_LEVEL is {name}: this machine runs {', '.join(usable(best))}")
    return name


def usable(best: str) -> list[str]:
    """The levels that a machine of level `best` can run."""
    return list(X86)[: list(X86).index(best) + 1] if best in X86 else [best]


def _best() -> str:
    machine = platform.machine().lower()
    if machine in ("arm64", "aarch64"):
        return "aarch64"
    if machine not in ("x86_64", "amd64"):
        return OTHER
    for name in X86:  # any of the libraries can tell
        with suppress(OSError, AttributeError):  # there is none, or it is damaged
            return (OTHER, *X86)[read_level(library_path(LIBRARIES, name))]
    if find_spec("llvmlite") is None:
        return OTHER
    import llvmlite.binding as llvm

    has = llvm.get_host_cpu_features()
    return next((name for name, needs in reversed(X86.items()) if all(has.get(f) for f in needs)), OTHER)


def library_path(folder: Path, level: str, suffix: str = SUFFIXES.get(sys.platform, ".so")) -> Path:
    """The library of a processor level; `suffix`: of its system's shared libraries."""
    return folder / f"libantumbra-{level}{suffix}"


def read_level(library: Path) -> int:
    """The level of this x86 processor, 1 to 3 for v2 to v4 and 0 below, by the function in a kernel library."""
    function = ctypes.CDLL(str(library)).antumbra_x86_level
    function.restype = ctypes.c_int64
    return int(function())
