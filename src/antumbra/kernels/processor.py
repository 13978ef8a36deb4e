"""Levels of processors: the instructions that machine code may use. One pack serves all machines of a level.

`x86-64-v2`, `-v3` (AVX2, FMA) and `-v4` (AVX-512) are the levels of the x86-64 psABI. `aarch64` has NEON. The default
is the best level of this processor. ``ANTUMBRA_LEVEL`` chooses another one.
"""

import os
import platform
from functools import cache

from ..errors import InputError

_V2 = ["cx16", "sahf", "popcnt", "sse3", "ssse3", "sse4.1", "sse4.2"]
_V3 = [*_V2, *["avx", "avx2", "bmi", "bmi2", "f16c", "fma", "lzcnt", "movbe", "xsave"]]
_V4 = [*_V3, *["avx512f", "avx512bw", "avx512cd", "avx512dq", "avx512vl"]]
X86 = {"x86-64-v2": _V2, "x86-64-v3": _V3, "x86-64-v4": _V4}
"""Level: its features, by LLVM's names. The name of a level is also LLVM's name of a processor."""

LEVELS = (*X86, "aarch64")
OTHER = "generic"
"""The level of other machines: LLVM's generic processor."""


@cache
def level() -> str:
    """The level for which kernels are compiled on this machine."""
    wanted = os.environ.get("ANTUMBRA_LEVEL")
    best = _best()
    if not wanted:
        return best
    if wanted not in usable(best):
        raise InputError(f"ANTUMBRA_LEVEL is {wanted}: this machine runs {', '.join(usable(best))}")
    return wanted


def usable(best: str) -> list[str]:
    """The levels that a machine of level `best` can run."""
    return list(X86)[: list(X86).index(best) + 1] if best in X86 else [best]


def _best() -> str:
    machine = platform.machine().lower()
    if machine in ("arm64", "aarch64"):
        return "aarch64"
    if machine not in ("x86_64", "amd64"):
        return OTHER
    import llvmlite.binding as llvm

    has = llvm.get_host_cpu_features()
    return next((name for name, needs in reversed(X86.items()) if all(has.get(f) for f in needs)), OTHER)
