"""Files that are written whole or not at all."""

import os
import stat
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

from .errors import InputError
from .temporary import temporary_name


def checked_output(path, suffixes: Sequence[str]) -> Path:
    """`path` if a file of one of these kinds can be written there; to be asked before long work begins.

    Parameters
    ----------
    path : str or path-like
    suffixes : sequence of str
        In lower case, such as ``(".png", ".exr")``.

    Raises
    ------
    InputError
        On another suffix, a folder that is missing or closed to us, or a path that is no ordinary file.
    """
    try:
        path = Path(os.fspath(path))
    except TypeError:
        raise InputError(f"output path is {path!r}; it must be a string or a path") from None
    mode = _mode(path)
    kinds = " or ".join(suffixes)
    if mode is not None and stat.S_ISDIR(mode):
        raise InputError(f"{path}: is a folder; name a {kinds} file in it")
    if path.suffix.lower() not in suffixes:
        kind = f"unknown suffix {path.suffix!r}" if path.suffix else "the name has no suffix"
        raise InputError(f"{path}: {kind}; use {kinds}")
    if mode is not None and not stat.S_ISREG(mode):
        raise InputError(f"{path}: is not an ordinary file; choose another name")
    _check_access(path, exists=mode is not None)
    return path


@contextmanager
def replacing(path) -> Iterator[Path]:
    """Gives a temporary name beside `path`; what is written there becomes `path` if no exception comes.

    Raises
    ------
    InputError
        Where the writing fails: names `path` and the reason. Nothing is left behind, and an older file stays as it was.
    """
    target = Path(os.path.realpath(path))  # a symbolic link stays one
    try:
        with temporary_name(target.parent) as temporary:
            yield temporary
            os.replace(temporary, target)
    except OSError as error:
        raise InputError(f"{path}: cannot be written ({_reason(error)}); choose another place") from error


def _mode(path: Path) -> int | None:
    try:
        return os.stat(path).st_mode
    except FileNotFoundError:
        return None
    except NotADirectoryError:
        raise InputError(f"{path}: {path.parent} is not a folder; choose another place") from None
    except (OSError, ValueError) as error:
        raise InputError(f"{path}: cannot be written ({_reason(error)}); choose another place") from None


def _check_access(path: Path, exists: bool) -> None:
    folder = os.path.dirname(os.path.realpath(path))
    if not os.path.isdir(folder):
        raise InputError(f"{path}: the folder {folder} does not exist; make it first")
    if not os.access(folder, os.W_OK | os.X_OK):
        raise InputError(f"{path}: no permission to write in {folder}; choose another place")
    if exists and not os.access(path, os.W_OK):
        raise InputError(f"{path}: is write-protected; choose another name")


def _reason(error: Exception) -> str:
    return " ".join(str(getattr(error, "strerror", None) or error).split()) or type(error).__name__
