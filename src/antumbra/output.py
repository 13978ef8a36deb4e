"""Files that are written whole or not at all."""

import os
import stat
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

from .errors import InputError
from .temporary import temporary_name


def checked_output(path, suffixes: Sequence[str]) -> Path:
    """Check, before long work begins, that a file of one of these kinds can be written; return `path` as a `Path`.

    Parameters
    ----------
    path : str or path-like
    suffixes : sequence of str
        Allowed suffixes in lower case, such as ``(".png", ".exr")``.

    Raises
    ------
    InputError
        If the suffix is not allowed, the folder is missing or not writable, or `path` is not an ordinary file.
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
def replacing(path, *, durable: bool = False) -> Iterator[Path]:
    """Yield a temporary name beside `path`; on exit without an exception the temporary file replaces `path`.

    durable : wait until the disk has the new name, so that not even a power failure undoes it

    Raises
    ------
    InputError
        If writing fails; the message names `path` and the reason. No file is left behind, and an older file survives.
    """
    target = Path(os.path.realpath(path))  # a symbolic link stays a link
    try:
        with temporary_name(target.parent) as temporary:
            yield temporary
            os.replace(temporary, target)
            if durable:
                _sync_folder(target.parent)
    except OSError as error:
        raise InputError(f"{path}: cannot be written ({_reason(error)}); choose another place") from error


def _sync_folder(folder: Path) -> None:
    if os.name == "posix":  # Windows opens no folders
        descriptor = os.open(folder, os.O_RDONLY)
        try:
            os.fsync(descriptor)
        finally:
            os.close(descriptor)


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
