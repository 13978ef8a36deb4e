"""A lock between processes: a file that one process holds until it releases it or ends."""

import os
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

_POLL_SECONDS = 0.05

if os.name == "nt":
    import msvcrt

    def _try_lock(handle: int) -> bool:
        try:
            msvcrt.locking(handle, msvcrt.LK_NBLCK, 1)  # type: ignore[attr-defined]
        except OSError:
            return False
        return True

else:
    import fcntl

    def _try_lock(handle: int) -> bool:
        try:
            fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            return False
        return True


@contextmanager
def held(path: Path) -> Iterator[None]:
    """Hold the lock `path` within the context, after waiting for the process that has it. Ctrl-C ends the waiting.

    The file is removed at the end. A process that waited then holds a file without a name. So callers check again,
    within the context, whether the work is still to be done.
    """
    handle = os.open(path, os.O_RDWR | os.O_CREAT, 0o666)
    try:
        while not _try_lock(handle):
            time.sleep(_POLL_SECONDS)
        yield
    finally:
        if os.name != "nt":
            with suppress(OSError):
                path.unlink()
        os.close(handle)
