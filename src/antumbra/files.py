"""Path checks: files that may be read, and references from one file to another."""

import ctypes
import io
import os
import re
import sys
from collections.abc import Iterator
from contextlib import contextmanager, redirect_stderr, redirect_stdout, suppress
from pathlib import Path
from urllib.parse import unquote

from .errors import InputError

_SCHEME = re.compile(r"[A-Za-z][A-Za-z0-9+.-]*:")


def checked_file(path: Path, where: str) -> Path:
    """`path`, if it is an ordinary file. A pipe or device could block for ever."""
    if not path.exists():
        raise InputError(f"{where}: no such file; check the path")
    if not path.is_file():
        raise InputError(f"{where}: not an ordinary file; name a scene file")
    if path.stat().st_size == 0:
        raise InputError(f"{where}: the file is empty; export or copy it again")
    return path


@contextmanager
def without_output() -> Iterator[None]:
    """Drop what libraries write to standard output and error: OpenEXR reports a damaged file there, too, from C++."""
    _flush()
    kept = {}
    for number in (1, 2):
        with suppress(OSError):  # a stream that is closed
            kept[number] = os.dup(number)
    null = os.open(os.devnull, os.O_WRONLY)
    try:
        for number in kept:
            os.dup2(null, number)
        with redirect_stdout(io.StringIO()), redirect_stderr(io.StringIO()):
            yield
    finally:
        _flush()
        for number, old in kept.items():
            os.dup2(old, number)
            os.close(old)
        os.close(null)


def _flush() -> None:
    """Flush the standard streams: those of Python, and those of C."""
    for stream in (sys.stdout, sys.stderr):
        with suppress(OSError, ValueError, AttributeError):
            stream.flush()
    with suppress(OSError, AttributeError, TypeError):
        ctypes.CDLL(None).fflush(None)


def sibling(folder: Path, uri: str, where: str) -> Path:
    """The file of a relative `uri` in a scene. Raises InputError unless it is in the scene's `folder`."""
    name = unquote(uri)
    shown = uri if len(uri) <= 80 else uri[:77] + "..."
    if _SCHEME.match(uri) or uri.startswith(("//", "\\\\")):
        raise InputError(f"{where} is {shown!r}; only files in the scene's folder are read, put it there")
    if not name or not name.isprintable() or name.startswith(("/", "\\")) or _SCHEME.match(name):
        raise InputError(f"{where} is {shown!r}; it must be a relative path in the scene's folder")
    base = folder.resolve()
    path = (base / name).resolve()
    if not path.is_relative_to(base):
        raise InputError(f"{where} is {shown!r}, outside the scene's folder; put the file beside the scene")
    return path
