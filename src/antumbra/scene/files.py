"""Checks of paths: files that may be read, and references from a file to others."""

import re
from pathlib import Path
from urllib.parse import unquote

from ..errors import InputError

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
