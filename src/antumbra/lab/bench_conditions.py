"""Measurement conditions stored with results: the command, the machine, the kernels and the spread of timings.

Pages made from results (`scripts/paper_pages.py`) show the conditions, and refuse results of kernels that have changed.
"""

import sys
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from contextvars import ContextVar
from datetime import UTC, datetime
from statistics import median, quantiles
from typing import Any

from ..cli.installation_commands import about

KernelDigests = dict[str, dict[str, str]]
"""Kernel -> its argument types -> digest of its code and of all that it reaches."""


def conditions(command: str, quick: bool) -> dict[str, Any]:
    """The command, the date, versions and hardware.

    quick : whether the command measured less than usual
    """
    return {"command": command, "quick": quick, "date": f"{datetime.now(UTC):%Y-%m-%d %H:%M} UTC", **about()}


# --- Kernels ----------------------------------------------------------------------------------------------------------


def kernel_digests(calls: Iterable[tuple[str, str]]) -> KernelDigests:
    """The digests of kernels: (name, kinds of arguments), as `jit.recorded_calls` yields them."""
    digests: KernelDigests = {}
    for name, key in sorted(calls):
        digests.setdefault(name, {})[key] = _digest_now(name, key)
    return digests


def changed_kernels(recorded: Mapping[str, Mapping[str, str]]) -> list[str]:
    """The names of the kernels whose code has changed since they were recorded, or that no longer exist.

    Digests depend on the Python version.
    """
    return [
        name
        for name, digests in recorded.items()
        if any(_digest_now(name, key) != digest for key, digest in digests.items())
    ]


def _digest_now(name: str, key: str) -> str:
    """The digest of a kernel in the present code; empty if there is no such kernel."""
    from ..kernels.marshalling import import_object
    from ..kernels.toolchain.kernel_digest import kernel_digest

    try:
        return kernel_digest(import_object(name), key)
    except (ImportError, AttributeError):
        return ""


def python_of_digests() -> str:
    """The Python version on which digests depend, such as 3.11."""
    return f"{sys.version_info[0]}.{sys.version_info[1]}"


# --- The spread of timings --------------------------------------------------------------------------------------------


SHORTEST = 1e-4
"""Seconds: the spread of shorter timings says more about the clock than about the method."""

_spreads: ContextVar[list[float] | None] = ContextVar("spreads", default=None)


@contextmanager
def collected_spreads() -> Iterator[list[float]]:
    """Collect the spreads that `record_laps` records in this block."""
    spreads: list[float] = []
    token = _spreads.set(spreads)
    try:
        yield spreads
    finally:
        _spreads.reset(token)


def record_laps(laps: Sequence[Any]) -> None:
    """Record the spread of repeated timings of one case: the range of each, relative to its median.

    laps : one entry per round: seconds, or tuples and mappings of seconds. Other values are ignored.
    """
    spreads = _spreads.get()
    if spreads is None or len(laps) < 2:
        return
    if isinstance(laps[0], Mapping):
        for name in laps[0]:
            record_laps([lap[name] for lap in laps if name in lap])
    elif isinstance(laps[0], tuple):
        for column in zip(*laps):
            record_laps(column)
    elif isinstance(laps[0], float) and median(laps) >= SHORTEST:
        spreads.append((max(laps) - min(laps)) / median(laps))


def summary_of(spreads: Sequence[float]) -> dict[str, float]:
    """The number of timings, and the median and ninth decile of their spreads; empty without repeated timings."""
    if not spreads:
        return {}
    ninth = quantiles(spreads, n=10, method="inclusive")[-1] if len(spreads) > 1 else spreads[0]
    return {"timings": len(spreads), "median": median(spreads), "ninth_decile": ninth}
