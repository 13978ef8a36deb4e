"""The memory of this process."""

import ctypes
import mmap
import sys
from contextlib import suppress


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
