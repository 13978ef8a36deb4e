"""How every kernel is compiled: one decorator, one cache.

Numba notices an edit of a kernel's own file, not of the functions inlined into it from other files. So the cache lives
in a folder named after the contents of all the package's sources: a changed installation never meets stale machine
code, and a read-only installation can cache too. Set ``NUMBA_CACHE_DIR`` to choose the folder yourself.
"""

import hashlib
import os
import sys
from pathlib import Path

import numba


def _user_cache() -> Path:
    if sys.platform == "win32":
        return Path(os.environ.get("LOCALAPPDATA", Path.home() / "AppData" / "Local"))
    if sys.platform == "darwin":
        return Path.home() / "Library" / "Caches"
    return Path(os.environ.get("XDG_CACHE_HOME", Path.home() / ".cache"))


def _source_digest() -> str:
    digest = hashlib.sha1(numba.__version__.encode(), usedforsecurity=False)
    for path in sorted(Path(__file__).parent.rglob("*.py")):
        digest.update(path.read_bytes())
    return digest.hexdigest()[:16]


def _choose_cache() -> Path:
    if not numba.config.CACHE_DIR:
        numba.config.CACHE_DIR = str(_user_cache() / "antumbra" / _source_digest())
    return Path(numba.config.CACHE_DIR)


CACHE_DIR = _choose_cache()

kernel = numba.njit(cache=True, nogil=True, error_model="numpy")
"""Decorator of every compiled function: cached on disk, free of the GIL, IEEE division, no fast-math."""

inlined = numba.njit(cache=True, nogil=True, error_model="numpy", forceinline=True)
"""The same for small functions on hot paths: LLVM must inline them, whatever it thinks."""
