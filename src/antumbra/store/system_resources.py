"""System resources: free disk space, resident memory of this process, and reused pages for chunks.

Reading into reused memory is faster: clearing new pages would take the system longer than a read.
"""

import ctypes
import mmap
import shutil
import sys
from contextlib import suppress
from pathlib import Path
from threading import Lock

import numpy as np

from ..errors import InputError

# --- The room on a disk that a build takes ----------------------------------------------------------------------------


TRIANGLE_BYTES = 130
"""Bytes on the disk for each triangle, at most: 75 of the store, and 55 of temporary files."""


def check_space(folder: Path, file: str, triangles: int, written: int = 0) -> None:
    """Raise an InputError if a folder has no room to build a store of so many triangles.

    written : bytes of temporary files that are there already
    """
    try:
        free = shutil.disk_usage(folder).free
    except OSError:  # some file systems do not tell
        return
    need = TRIANGLE_BYTES * triangles - written
    if need > free:
        raise InputError(
            f"{file}: {triangles:,} triangles take about {need / 1e9:,.1f} GB while they are built, and "
            f"{folder} has {free / 1e9:,.1f} GB left; free some, or choose another place"
        )


# --- The memory of this process ---------------------------------------------------------------------------------------


def peak_resident() -> int | None:
    """Peak resident memory of this process in bytes, mapped files included; None if unknown."""
    try:
        import resource
    except ImportError:  # Windows
        return None
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return peak if sys.platform == "darwin" else peak * 1024


def resident() -> int:
    """Resident memory of this process in bytes; its peak where the system does not report it."""
    try:
        with open("/proc/self/statm") as stream:
            return int(stream.read().split()[1]) * mmap.PAGESIZE
    except OSError:
        return peak_resident() or 0


def release_freed() -> None:
    """Give memory that was freed, but that the C library keeps, back to the system, where it can (glibc)."""
    with suppress(AttributeError, OSError, TypeError):
        ctypes.CDLL(None).malloc_trim(0)


# ---------------------------------------------------------------------------------------------------------------------
# Memory for chunks, used again when a chunk leaves: the system would clear new pages for longer than a read takes.


class Pool:
    """Pieces of memory that no chunk uses now. Several threads may use it at the same time."""

    def __init__(self):
        self._free: list[np.ndarray] = []
        self._lock = Lock()

    @property
    def bytes(self) -> int:
        """Bytes of the free memory."""
        return sum(map(len, self._free))

    def take(self, size: int, most: int) -> np.ndarray:
        """(n,) uint8 with `size` <= n <= `most`: a free piece, or new memory; then as much free memory is released."""
        with self._lock:
            fits = [i for i, piece in enumerate(self._free) if size <= len(piece) <= most]
            if fits:
                return self._free.pop(min(fits, key=lambda i: len(self._free[i])))
            released = 0
            while self._free and released < size:
                released += len(self._free.pop())
        return np.frombuffer(mmap.mmap(-1, max(size, 1)), np.uint8)

    def give(self, piece: np.ndarray) -> None:
        """Keep a piece for a chunk that comes later."""
        with self._lock:
            self._free.append(piece)

    def clear(self) -> None:
        """Release all free memory."""
        with self._lock:
            self._free.clear()
