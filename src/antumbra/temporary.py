"""Names of temporary files, and the removal of those that a killed process left behind.

Before a process creates ``.antumbra-0123456789ab.tmp``, it creates the empty ``.antumbra-0123456789ab.lock`` and locks
it. The system releases the lock when the process ends, however it ends. So a file whose lock is free is abandoned. This
also holds if its owner ran in another container, or on another machine that shares the folder.

The lock is a separate file because SMB and Windows forbid writing to a locked file.
"""

import os
import re
import secrets
import shutil
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from functools import cache
from pathlib import Path

from .kernels.locks import lock
from .kernels.private import HELD, hold

_OURS = re.compile(r"(\.antumbra-[0-9a-f]{12})\.(tmp|lock)")
_FOLDER = re.compile(r"antumbra-(?:[a-z]+-)?[a-z0-9_]{8}")  # as mkdtemp names it
_YOUNG = 10.0  # seconds in which a folder without a locked file is not abandoned
_TRIES = 3  # attempts to lock a name before a file is created without a lock


@contextmanager
def temporary_name(folder: str | Path) -> Iterator[Path]:
    """Yield a new name in `folder`, reserved while this process lives; on exit a file of that name is removed.

    The first call for a folder also removes the files that killed processes left there.

    Raises
    ------
    OSError
        If no file can be created in `folder`.
    """
    remove_abandoned(os.path.realpath(folder))
    path, held = _reserved(Path(folder))
    try:
        yield path
    finally:
        with suppress(OSError):
            path.unlink()
        if held is not None:
            os.close(held)  # first, for Windows
            with suppress(OSError):
                path.with_suffix(".lock").unlink()


@contextmanager
def temporary_folder() -> Iterator[Path]:
    """Yield a new folder for this user among the temporary files, which is removed on exit.

    The first call also removes the folders of this user that killed processes left.
    """
    parent = tempfile.gettempdir()
    _remove_abandoned_folders(parent)
    folder = tempfile.mkdtemp(prefix="antumbra-", dir=parent)
    held = hold(folder)
    try:
        yield Path(folder)
    finally:
        os.close(held)  # first, for Windows
        shutil.rmtree(folder, ignore_errors=True)


@cache
def _remove_abandoned_folders(parent: str) -> None:
    with suppress(OSError), os.scandir(parent) as entries:
        for entry in entries:
            if _FOLDER.fullmatch(entry.name) and entry.is_dir(follow_symlinks=False) and _is_own(entry):
                with suppress(OSError):
                    _remove_folder_if_abandoned(entry.path)


def _is_own(entry: os.DirEntry) -> bool:
    return not hasattr(os, "getuid") or entry.stat(follow_symlinks=False).st_uid == os.getuid()


def _remove_folder_if_abandoned(folder: str) -> None:
    """Remove a folder whose owner has ended; OSError if it is alive or cannot be determined."""
    held = os.open(os.path.join(folder, HELD), os.O_RDWR | getattr(os, "O_NOFOLLOW", 0) | getattr(os, "O_NONBLOCK", 0))
    try:
        if time.time() - os.fstat(held).st_mtime > _YOUNG:  # its owner may be about to lock it
            lock(held)
            shutil.rmtree(folder, ignore_errors=True)
    finally:
        os.close(held)


@cache  # listing a folder with many thousand frames is slow
def remove_abandoned(folder: str) -> None:
    """Remove Antumbra's temporary files in `folder` whose owner has ended; files without a known owner stay."""
    with suppress(OSError), os.scandir(folder) as entries:
        files = [entry.name for entry in entries if entry.is_file(follow_symlinks=False)]
        for stem in {found[1] for name in files if (found := _OURS.fullmatch(name))}:
            with suppress(OSError):  # another user's, write-protected, or already gone
                _remove_if_abandoned(os.path.join(folder, stem))


def _reserved(folder: Path) -> tuple[Path, int | None]:
    """A new name and the descriptor that holds its lock; None: the file system has no locks."""
    for _ in range(_TRIES):
        path = folder / f".antumbra-{secrets.token_hex(6)}.tmp"
        file = path.with_suffix(".lock")
        descriptor = os.open(file, os.O_RDWR | os.O_CREAT | os.O_EXCL, 0o666)
        with suppress(OSError):
            lock(descriptor)
            if os.fstat(descriptor).st_nlink:  # 0: another process removed it as abandoned before it was locked
                return path, descriptor
        os.close(descriptor)
        with suppress(OSError):
            file.unlink()
    return path.with_suffix(".part"), None  # without a lock, no process ever removes it


def _remove_if_abandoned(stem: str) -> None:
    """Remove ``stem.tmp`` and ``stem.lock``; OSError if their owner is alive or cannot be determined."""
    descriptor = _claimed(stem + ".lock")
    try:
        for suffix in (".tmp", ".lock"):  # the lock goes last: while it exists, only one process can remove the file
            with suppress(FileNotFoundError):
                os.unlink(stem + suffix)
    finally:
        if descriptor is not None:
            os.close(descriptor)


def _claimed(file: str) -> int | None:
    """Lock an abandoned lock file: its descriptor; None: the file is gone, since its owner removed it last."""
    try:
        if os.name == "nt":
            os.unlink(file)  # fails while its owner has it open
            return None
        descriptor = os.open(file, os.O_RDWR | os.O_NOFOLLOW | os.O_NONBLOCK)
    except FileNotFoundError:
        return None
    try:
        lock(descriptor)
    except OSError:
        os.close(descriptor)
        raise
    return descriptor
