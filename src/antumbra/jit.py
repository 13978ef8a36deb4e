"""How every kernel is compiled: one decorator, one cache.

Numba notices an edit of a kernel's own file, not of the functions inlined into it from other files. So the cache lives
in a folder named after the contents of all the package's sources: a changed installation never meets stale machine
code, and a read-only installation can cache too. ``NUMBA_CACHE_DIR`` chooses where these folders are.
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


CACHE_DIR = Path(os.environ.get("NUMBA_CACHE_DIR") or _user_cache() / "antumbra") / _source_digest()


def _compiled(**options):
    """A decorator like numba.njit that caches in CACHE_DIR; other users of Numba keep their own folder."""
    decorate = numba.njit(cache=True, nogil=True, error_model="numpy", **options)

    def wrap(function):
        kept, numba.config.CACHE_DIR = numba.config.CACHE_DIR, str(CACHE_DIR)
        try:
            return decorate(function)
        finally:
            numba.config.CACHE_DIR = kept

    return wrap


kernel = _compiled()
"""Decorator of every compiled function: cached on disk, free of the GIL, IEEE division, no fast-math."""

inlined = _compiled(forceinline=True)
"""The same for small functions on hot paths: LLVM must inline them, whatever it thinks."""
