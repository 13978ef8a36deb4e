"""Locks between processes: files that one process holds until it releases them or ends."""

import os
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

_POLL_SECONDS = 0.05
_FLAGS = os.O_RDWR | os.O_CREAT | getattr(os, "O_NOFOLLOW", 0) | getattr(os, "O_NONBLOCK", 0)

try:
    import fcntl
except ImportError:  # Windows
    import msvcrt

    fcntl = None  # type: ignore[assignment]


def lock(descriptor: int) -> None:
    """Lock an open file until it is closed, without waiting.

    Raises
    ------
    BlockingIOError
        If another process holds the lock.
    OSError
        If the file system has no locks.
    """
    if fcntl is not None:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        return
    try:
        msvcrt.locking(descriptor, msvcrt.LK_NBLCK, 1)  # type: ignore[attr-defined]
    except OSError as error:  # Windows does not tell why
        raise BlockingIOError(*error.args) from error


@contextmanager
def held(path: Path) -> Iterator[None]:
    """Hold the lock `path` within the context, after waiting for the process that has it. Ctrl-C ends the waiting.

    The file is removed at the end. A process that waited then holds a file without a name. So callers check again,
    within the context, whether the work is still to be done.
    """
    handle = os.open(path, _FLAGS, 0o600)
    try:
        while True:
            try:
                lock(handle)
                break
            except BlockingIOError:
                time.sleep(_POLL_SECONDS)
        yield
    finally:
        if os.name != "nt":
            with suppress(OSError):
                path.unlink()
        os.close(handle)
