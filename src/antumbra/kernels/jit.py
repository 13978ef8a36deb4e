"""How every kernel is compiled: one decorator, one cache.

Numba notices an edit of a kernel's own file, not of the functions inlined into it from other files. So the cache lives
in a folder named after the contents of all the package's sources: a changed installation never meets stale machine
code, and a read-only installation can cache too. ``NUMBA_CACHE_DIR`` chooses where these folders are.
"""

import functools
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
    decorate = numba.njit(cache=True, nogil=True, error_model="numpy", no_cfunc_wrapper=True, **options)

    def wrap(function):
        kept, numba.config.CACHE_DIR = numba.config.CACHE_DIR, str(CACHE_DIR)
        try:
            return decorate(function)
        finally:
            numba.config.CACHE_DIR = kept

    return wrap


kernel = _compiled()
"""Decorator of every compiled function: cached on disk, free of the GIL, IEEE division, no fast-math."""

_part = _compiled(forceinline=True, no_cpython_wrapper=True)


class inlined:
    """The same for small functions on hot paths: LLVM must inline them, whatever it thinks.

    Only kernels can call them. The function that would let Python call them holds all their code once more, and so does
    everything they are inlined into: without it, all is compiled in two thirds of the time.
    """

    def __init__(self, function):
        self.py_func, self._dispatcher = function, _part(function)
        self._numba_type_ = self._dispatcher._numba_type_  # what Numba takes this object for; it holds no reference
        functools.update_wrapper(self, function)

    def __call__(self, *arguments):
        raise TypeError(f"{self.__qualname__} is inlined; only kernels can call it")
