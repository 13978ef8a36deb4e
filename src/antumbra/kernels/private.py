"""Folders and files that nobody but this user, or the system, can change: machine code is loaded from no others."""

import atexit
import os
import shutil
import stat
import tempfile
from contextlib import suppress
from functools import cache
from pathlib import Path

from .locks import lock

HELD = ".lock"
"""The file in a temporary folder that is locked while its owner lives; see `antumbra.temporary`."""

_WRITABLE = stat.S_IWGRP | stat.S_IWOTH
_FLAGS = os.O_RDONLY | sum(getattr(os, name, 0) for name in ("O_NOFOLLOW", "O_NONBLOCK", "O_CLOEXEC", "O_BINARY"))


class Untrusted(OSError):
    """A folder or a file that other users can change; its text says which, and why."""


def make_folder(path: Path) -> None:
    """Make a folder, and those around it that are missing, for this user alone; one that is there stays as it is."""
    if not path.is_dir():
        make_folder(path.parent)
        path.mkdir(mode=0o700, exist_ok=True)


def checked_own(path: Path, status: os.stat_result | None = None) -> None:
    """Raise `Untrusted` if users other than this one and the system's own can change a file or a folder.

    Always passes on Windows, whose user folders are private.

    status : of the open file; None: that of `path`

    Raises
    ------
    OSError
        If it is not there.
    """
    status = path.stat() if status is None else status
    if not hasattr(os, "getuid"):
        return
    if status.st_uid not in (os.getuid(), 0):
        raise Untrusted(f"{path} belongs to another user (id {status.st_uid})")
    if status.st_mode & stat.S_IWOTH or (status.st_mode & stat.S_IWGRP and not _is_own_group(status.st_gid)):
        raise Untrusted(f"{path} can be changed by other users (try: chmod go-w)")


def read_own(path: Path) -> bytes:
    """The contents of an ordinary file of this user or of the system.

    Raises
    ------
    OSError
        If it is not there, is a link, a pipe or a device, or if others can change it (`Untrusted`).
    """
    descriptor = os.open(path, _FLAGS)  # without O_NONBLOCK, a pipe would block for ever
    with open(descriptor, "rb") as file:
        status = os.fstat(descriptor)
        if not stat.S_ISREG(status.st_mode):
            raise Untrusted(f"{path} is not an ordinary file")
        checked_own(path, status)
        return file.read()


@cache
def private_folder(name: str) -> Path:
    """A new folder among the temporary files, for this process alone. It is removed when the process ends.

    If the process is killed, a later one removes it, see `antumbra.temporary`.
    """
    folder, owner = Path(tempfile.mkdtemp(prefix=f"antumbra-{name}-")), os.getpid()
    hold(folder)
    atexit.register(lambda: shutil.rmtree(folder, ignore_errors=True) if os.getpid() == owner else None)
    return folder


def hold(folder: str | Path) -> int:
    """Mark a temporary folder as this process's own while it lives; return the descriptor that holds the lock."""
    held = os.open(os.path.join(folder, HELD), os.O_RDWR | os.O_CREAT, 0o600)
    with suppress(OSError):  # without locks, no process ever removes it
        lock(held)
    return held


def _is_own_group(group: int) -> bool:
    """Whether a group is this user's own, as many systems make one for each user, without other members."""
    try:
        import grp
        import pwd

        user, found = pwd.getpwuid(os.getuid()), grp.getgrgid(group)
    except (ImportError, KeyError):
        return False
    return user.pw_gid == group and found.gr_name == user.pw_name and set(found.gr_mem) <= {user.pw_name}
