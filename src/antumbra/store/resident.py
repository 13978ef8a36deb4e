"""How much memory a process has had."""

import mmap
import sys


def peak_resident() -> int | None:
    """Bytes that this process had in memory at its peak, its own and those of mapped files; None: nobody knows."""
    try:
        import resource
    except ImportError:  # Windows
        return None
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return peak if sys.platform == "darwin" else peak * 1024


def resident() -> int:
    """Bytes that this process has in memory now; its peak where the system does not say."""
    try:
        with open("/proc/self/statm") as stream:
            return int(stream.read().split()[1]) * mmap.PAGESIZE
    except OSError:
        return peak_resident() or 0
