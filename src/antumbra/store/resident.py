"""The memory of this process."""

import mmap
import sys


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
