"""Names of temporary files, and the removal of those that a killed process left behind.

The maker of ``.antumbra-0123456789ab.tmp`` first makes the empty ``.antumbra-0123456789ab.lock`` and locks it. The
system gives the lock back when the process ends, however it ends. So a file whose lock can be had belongs to nobody,
also when its maker ran in another container, or on another machine that shares the folder.

The lock has a file of its own, since SMB and Windows let nobody write to a file that is locked.
"""

import os
import re
import secrets
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from functools import cache
from pathlib import Path

try:
    import fcntl
except ImportError:  # Windows, where nobody can remove a file that is open
    fcntl = None

_OURS = re.compile(r"(\.antumbra-[0-9a-f]{12})\.(tmp|lock)")
_TRIES = 3  # to lock a name, before a file goes without


@contextmanager
def temporary_name(folder: str | Path) -> Iterator[Path]:
    """A new name in `folder` that nobody removes while this process lives; at the end a file of that name is removed.

    Before that, the first call for a folder removes what killed processes left there.

    Raises
    ------
    OSError
        Where no file can be made.
    """
    remove_abandoned(os.path.realpath(folder))
    path, lock = _reserved(Path(folder))
    try:
        yield path
    finally:
        with suppress(OSError):
            path.unlink()
        if lock is not None:
            os.close(lock)  # first, for Windows
            with suppress(OSError):
                path.with_suffix(".lock").unlink()


@cache  # a folder with many thousand frames takes long to list
def remove_abandoned(folder: str) -> None:
    """Remove our temporary files in `folder` whose makers live no more; those of unknown makers stay."""
    with suppress(OSError), os.scandir(folder) as entries:
        files = [entry.name for entry in entries if entry.is_file(follow_symlinks=False)]
        for stem in {found[1] for name in files if (found := _OURS.fullmatch(name))}:
            with suppress(OSError):  # of another user, in a folder that is write-protected, or gone by now
                _remove_if_abandoned(os.path.join(folder, stem))


def _reserved(folder: Path) -> tuple[Path, int | None]:
    """A new name, and the descriptor that holds its lock; None: locks do not work there."""
    for _ in range(_TRIES):
        path = folder / f".antumbra-{secrets.token_hex(6)}.tmp"
        lock = path.with_suffix(".lock")
        descriptor = os.open(lock, os.O_RDWR | os.O_CREAT | os.O_EXCL, 0o666)
        with suppress(OSError):
            _lock(descriptor)
            if os.fstat(descriptor).st_nlink:  # 0: before it was locked, another process took it for abandoned
                return path, descriptor
        os.close(descriptor)
        with suppress(OSError):
            lock.unlink()
    return path.with_suffix(".part"), None  # nobody can know whether its maker lives, so this name is never removed


def _remove_if_abandoned(stem: str) -> None:
    """Remove ``stem.tmp`` and ``stem.lock``; OSError where their maker lives, or where nobody can know."""
    descriptor = _claimed(stem + ".lock")
    try:
        for suffix in (".tmp", ".lock"):  # the lock last: as long as it is there, one process removes the file
            with suppress(FileNotFoundError):
                os.unlink(stem + suffix)
    finally:
        if descriptor is not None:
            os.close(descriptor)


def _claimed(lock: str) -> int | None:
    """The descriptor of a lock that nobody else holds; None: it is gone, for a maker removes it last."""
    try:
        if fcntl is None:
            os.unlink(lock)  # an error while its maker has it open
            return None
        descriptor = os.open(lock, os.O_RDWR | os.O_NOFOLLOW | os.O_NONBLOCK)
    except FileNotFoundError:
        return None
    try:
        _lock(descriptor)
    except OSError:
        os.close(descriptor)
        raise
    return descriptor


def _lock(descriptor: int) -> None:
    """OSError if another process has the lock, or if the file system has none."""
    if fcntl is not None:  # else an open file is locked
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
