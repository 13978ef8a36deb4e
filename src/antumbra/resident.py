"""How much memory a process has had."""

import sys


def peak_resident() -> int | None:
    """Bytes that this process had in memory at its peak, its own and those of mapped files; None: nobody knows."""
    try:
        import resource
    except ImportError:  # Windows
        return None
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return peak if sys.platform == "darwin" else peak * 1024
