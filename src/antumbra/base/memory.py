"""Memory limits of reading: what a file will take is compared with a limit before it is allocated.

Files declare sizes, and some expand: a raster of a few hundred bytes can have a billion cells. By default, reading may
take all memory that is available, but not more than 1 GiB or a hundred times the size of the file, whichever is larger.
A limit that the user gives replaces both.
"""

import os
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from contextvars import ContextVar
from pathlib import Path

from .checks import byte_count
from .errors import InputError
from .wording import counted

LEAST_LIMIT = 1 << 30
"""Bytes that reading any file may take, if they are available."""

RATIO = 100
"""A file may take this multiple of its size, even beyond `LEAST_LIMIT`."""

_given: ContextVar[int | None] = ContextVar("antumbra_reading_limit", default=None)
_CGROUP = Path("/sys/fs/cgroup")


@contextmanager
def reading_limit(max_memory: int | None) -> Iterator[None]:
    """Within the context, reading may take `max_memory` bytes; None: the limit stays as it is.

    Raises
    ------
    InputError
        If `max_memory` is not a number of bytes.
    """
    token = _given.set(_given.get() if max_memory is None else byte_count(max_memory, "max_memory", 1))
    try:
        yield
    finally:
        _given.reset(token)


def memory_limit() -> int | None:
    """Bytes that reading and work on what was read may take: the limit that was given, or what is available."""
    return _given.get() or available_memory()


def check_reading(size: float, where: str, stored: int | None = None, cure: str = "make it smaller") -> None:
    """Raise an InputError if reading takes more memory than the limit.

    size : expected bytes of memory
    where : what is read, as the subject of the error
    stored : bytes of the files that are read; None: compare with the available memory only
    cure : what to do instead of raising the limit
    """
    limit, reason = _given.get(), "the limit"
    if limit is None:
        limit, reason = available_memory(), "what is available"
        if stored is not None and (limit is None or max(LEAST_LIMIT, RATIO * stored) < limit):
            limit, reason = max(LEAST_LIMIT, RATIO * stored), f"files of {readable_size(stored)} need at most"
    if limit is not None and size > limit:
        raise InputError(
            f"{where} takes about {readable_size(size)} of memory, more than {reason} ({readable_size(limit)}); "
            f"{cure}, or raise max_memory, for example --max-memory {-(-int(size) >> 20)}M"
        )


def readable_size(size: float) -> str:
    """A number of bytes for messages, such as ``1.5 GB``."""
    for unit, factor in (("GB", 1e9), ("MB", 1e6), ("kB", 1e3)):
        if size >= factor:
            return f"{size / factor:,.1f} {unit}"
    return counted(round(size), "byte")


def available_memory() -> int | None:
    """Bytes of memory that this process can use without swapping; None if the system does not say.

    That is the least of what the system, the container, and the limit on this process's address space leave.
    """
    left = [_left_in_system(), _left_in_container(), _left_in_address_space()]
    return min((each for each in left if each is not None), default=None)


def _left_in_system() -> int | None:
    with suppress(OSError, StopIteration, ValueError), open("/proc/meminfo") as stream:
        return next(1024 * int(line.split()[1]) for line in stream if line.startswith("MemAvailable:"))
    return None


def _left_in_container() -> int | None:
    with suppress(OSError, ValueError):  # "max", if there is no limit
        limit, used = (int((_CGROUP / f"memory.{name}").read_text()) for name in ("max", "current"))
        cached = (line.split() for line in (_CGROUP / "memory.stat").read_text().splitlines())
        used -= sum(int(size) for name, size in cached if name == "inactive_file")
        return max(limit - used, 0)
    return None


def _left_in_address_space() -> int | None:
    try:
        import resource  # not on Windows
    except ImportError:
        return None
    limit = resource.getrlimit(resource.RLIMIT_AS)[0]
    if limit == resource.RLIM_INFINITY:
        return None
    with suppress(OSError), open("/proc/self/statm") as stream:
        return max(limit - int(stream.read().split()[0]) * os.sysconf("SC_PAGE_SIZE"), 0)
    return limit
