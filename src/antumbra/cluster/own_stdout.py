"""Standard output for the calling thread alone, since it may be JSON: what Ray prints goes to standard error."""

import io
import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from threading import get_ident
from typing import Any


class _OwnStdout(io.TextIOBase):
    """A stream that writes to `stdout` for the thread that made it, and to standard error for others."""

    def __init__(self, stdout: Any):
        self._stdout, self._owner = stdout, get_ident()

    def write(self, text: str) -> int:
        stream = self._stdout if get_ident() == self._owner else sys.stderr
        return int(stream.write(text))

    def flush(self) -> None:
        self._stdout.flush()

    def isatty(self) -> bool:
        return bool(self._stdout.isatty())

    def fileno(self) -> int:
        return int(self._stdout.fileno())


@contextmanager
def own_stdout() -> Iterator[None]:
    """Within the context, other threads and libraries of other languages print to standard error."""
    before = sys.stdout
    try:
        before.flush()
        kept = os.dup(1)
        os.dup2(2, 1)
    except (AttributeError, OSError, ValueError):  # a stream is closed
        yield
        return
    stdout: Any = before
    if _number_of(before) == 1:
        stdout = open(kept, "w", encoding=before.encoding, errors="backslashreplace", closefd=False)  # noqa: SIM115
    try:
        sys.stdout = _OwnStdout(stdout)
        yield
    finally:
        stdout.flush()
        sys.stdout = before
        os.dup2(kept, 1)
        os.close(kept)


def _number_of(stream: Any) -> int | None:
    """The file descriptor of a stream; None: it has none."""
    try:
        return int(stream.fileno())
    except (AttributeError, OSError, ValueError):
        return None
