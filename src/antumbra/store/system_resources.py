"""System resources: free disk space, resident memory of this process, and reused buffers for chunks.

Reading into a reused buffer is faster: the system would take longer to clear new pages than to read a chunk.
"""

import ctypes
import mmap
import os
import shutil
import sys
from contextlib import suppress
from pathlib import Path
from threading import Lock

import numpy as np
from numpy.typing import NDArray

from ..base.errors import InputError
from ..kernels.array_pool import release_recycled

# --- Disk space -------------------------------------------------------------------------------------------------------


TRIANGLE_BYTES = 150
"""Upper bound on the disk space per triangle of a build without looks: 50 bytes in the store, the rest in its parts."""


def check_disk_space(folder: Path, file: str, triangles: int, written: int = 0, looks: int = 0) -> None:
    """Raise InputError unless the disk of `folder` has enough free space to build a store of `triangles` triangles.

    written : bytes of temporary files that are already there
    looks : bytes of the looks of all triangles, which are read to a file, and encoded in another one before it goes
    """
    try:
        free = shutil.disk_usage(folder).free
    except OSError:  # some file systems do not report it
        return
    need = TRIANGLE_BYTES * triangles + 2 * looks - written
    if need > free:
        raise InputError(
            f"{file}: {triangles:,} triangles take about {need / 1e9:,.1f} GB while they are built, and "
            f"{folder} has {free / 1e9:,.1f} GB left; free some, or choose another place"
        )


# --- Memory of this process -------------------------------------------------------------------------------------------


MAX_MEMORY = 4 << 30
"""Limit in bytes on the memory of work on stores, unless a user sets another; see `default_limit`."""

_MIN_SHARE = 1 << 30


def peak_resident_memory() -> int | None:
    """Peak resident memory of this process in bytes, mapped files included; None if unknown.

    Linux's `ru_maxrss` also has the peak of the parent process, up to the start of this one.
    """
    with suppress(OSError, StopIteration), open("/proc/self/status") as stream:
        return next(int(line.split()[1]) for line in stream if line.startswith("VmHWM:")) * 1024
    try:
        import resource
    except ImportError:  # Windows
        return None
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return peak if sys.platform == "darwin" else peak * 1024


def resident_memory() -> int:
    """Resident memory of this process in bytes; its peak where the system does not report the current size."""
    try:
        with open("/proc/self/statm") as stream:
            return int(stream.read().split()[1]) * mmap.PAGESIZE
    except OSError:
        return peak_resident_memory() or 0


def default_limit(held: int = 0) -> int:
    """Limit in bytes on the memory of this process, unless a user sets another, while it works on a store.

    It leaves at least 1 GiB to the store: the arrays of a notebook may already take more than `MAX_MEMORY`.

    held : bytes that the store already holds
    """
    return max(MAX_MEMORY, resident_memory() - held + _MIN_SHARE)


def release_freed() -> None:
    """Return freed memory that pools and the C library still hold to the system, as far as possible (glibc)."""
    release_recycled()
    with suppress(AttributeError, OSError, TypeError):
        ctypes.CDLL(None).malloc_trim(0)


def storage_bytes() -> int | None:
    """Bytes that this process has caused to be read from storage, also by page faults; None: not counted.

    Where the system does not count bytes (Linux does), the pages of major page faults, without those read ahead.
    """
    with suppress(OSError, StopIteration), open("/proc/self/io") as stream:
        return next(int(line.split()[1]) for line in stream if line.startswith("read_bytes:"))
    try:
        import resource  # not on Windows
    except ImportError:
        return None
    return resource.getrusage(resource.RUSAGE_SELF).ru_majflt * mmap.PAGESIZE


def drop_cached_pages(path: Path) -> None:
    """Drop a file's pages from the cache of the operating system, if it can, so that they are read from storage again.

    Pages that a process has mapped into memory stay.
    """
    if hasattr(os, "posix_fadvise"):
        with path.open("rb") as stream:
            os.fsync(stream.fileno())  # pages that have not been written cannot be dropped
            os.posix_fadvise(stream.fileno(), 0, 0, os.POSIX_FADV_DONTNEED)


# --- Reused buffers ---------------------------------------------------------------------------------------------------


class BufferPool:
    """Free buffers for chunks. It is thread-safe."""

    def __init__(self) -> None:
        self._free: list[NDArray[np.uint8]] = []
        self._lock = Lock()

    @property
    def bytes(self) -> int:
        """Total size of the free buffers."""
        return sum(map(len, self._free))

    def acquire(self, size: int, max_size: int) -> NDArray[np.uint8]:
        """A buffer of (n,) uint8 with `size` <= n <= `max_size`.

        It is a free one if one fits. Otherwise it is new, and free buffers of at least that size in total are dropped.
        """
        with self._lock:
            fits = [i for i, buffer in enumerate(self._free) if size <= len(buffer) <= max_size]
            if fits:
                return self._free.pop(min(fits, key=lambda i: len(self._free[i])))
            dropped = 0
            while self._free and dropped < size:
                dropped += len(self._free.pop())
        return np.frombuffer(mmap.mmap(-1, max(size, 1)), np.uint8)

    def release(self, buffer: NDArray[np.uint8]) -> None:
        """Return a buffer to the pool for a later chunk."""
        with self._lock:
            self._free.append(buffer)

    def clear(self) -> None:
        """Drop all free buffers."""
        with self._lock:
            self._free.clear()
