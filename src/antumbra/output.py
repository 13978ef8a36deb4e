"""Files that are written whole or not at all."""

import errno
import os
import shutil
import stat
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from tempfile import TemporaryFile

from .checks import path_of
from .errors import InputError
from .temporary import temporary_name

LEAST = 1 << 16
"""Bytes that any output may take."""

_UNSUPPORTED = errno.EOPNOTSUPP, errno.EINVAL, errno.ENOSYS


def checked_output(path, suffixes: Sequence[str], size: int = LEAST) -> Path:
    """Check, before long work begins, that a file of one of these kinds can be written; return `path` as a `Path`.

    Parameters
    ----------
    path : str or path-like
    suffixes : sequence of str
        Allowed suffixes in lower case, such as ``(".png", ".exr")``.
    size : int
        Bytes that the file will have, as far as is known.

    Raises
    ------
    InputError
        If the suffix is not allowed, the folder is missing, not writable or full, or `path` is not an ordinary file.

    Notes
    -----
    The folder gets an unnamed temporary file for a moment. That finds what permissions do not tell, such as quotas and
    read-only file systems.
    """
    path = path_of(path, "output path")
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
    check_room(path, size)
    return path


def checked_folder(path, parents: bool = False) -> Path:
    """Check, before long work begins, that a folder exists or can be made, and can be written in.

    parents : whether the folders around it are made too

    Raises
    ------
    InputError
        If `path` is not a folder, the folder around it is missing, or nothing can be written there.
    """
    path = path_of(path, "folder")
    mode = _mode(path)
    if mode is not None and not stat.S_ISDIR(mode):
        raise InputError(f"{path}: is a file; name a folder")
    inside = path / "file" if mode is not None else path
    while parents and not inside.parent.exists():
        inside = inside.parent
    _check_access(inside, exists=False)
    check_room(inside, LEAST)
    return path


def check_room(path: Path, size: int) -> None:
    """Raise an InputError unless a file of `size` bytes can be written at `path`, whose folder exists."""
    folder = os.path.dirname(os.path.realpath(path))
    try:
        with TemporaryFile(dir=folder) as file:
            file.write(bytes(min(size, LEAST)))
            file.flush()
        free = shutil.disk_usage(folder).free
    except OSError as error:
        raise InputError(f"{path}: cannot be written ({_reason(error)}); choose another place") from None
    if size > free:
        raise InputError(
            f"{path}: takes {size / 1e6:,.1f} MB, and {folder} has {free / 1e6:,.1f} MB left; free some, or choose "
            "another place"
        )


def reserve(descriptor: int, size: int) -> None:
    """Make an open file `size` bytes long, and reserve its space where the system can.

    A full disk is then an OSError here. Otherwise it would be one when parts of the file are written, or would end the
    process if they are written through a memory map.
    """
    try:
        os.posix_fallocate(descriptor, 0, size)
    except AttributeError:  # Windows, macOS
        os.truncate(descriptor, size)
    except OSError as error:
        if error.errno not in _UNSUPPORTED:
            raise
        os.truncate(descriptor, size)


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
