"""Measurement conditions stored with results: the command, the machine, the kernels and the spread of timings.

Pages made from results (`scripts/paper_pages.py`) show the conditions, and refuse results of kernels that have changed.
"""

import sys
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from contextvars import ContextVar
from datetime import UTC, datetime
from statistics import median, quantiles
from typing import Any, NamedTuple

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


def joined_digests(digests: Iterable[KernelDigests]) -> KernelDigests:
    """The digests of the kernels of several measurements."""
    joined: KernelDigests = {}
    for each in digests:
        for name, keys in each.items():
            joined[name] = {**joined.get(name, {}), **keys}
    return joined


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


# --- Rounds and spread of timings -------------------------------------------------------------------------------------


SHORTEST = 1e-4
"""Seconds: the spread of shorter timings says more about the clock than about the method."""


class CollectedLaps(NamedTuple):
    """What `record_laps` records."""

    spreads: list[float]  # of each repeated timing: its range, relative to its median
    rounds: list[int]  # of each case


_collected: ContextVar[CollectedLaps | None] = ContextVar("collected", default=None)


@contextmanager
def collected_laps() -> Iterator[CollectedLaps]:
    """Collect what `record_laps` records in this block."""
    laps = CollectedLaps([], [])
    token = _collected.set(laps)
    try:
        yield laps
    finally:
        _collected.reset(token)


def record_laps(laps: Sequence[Any]) -> None:
    """Record the rounds of one case, and the spread of its timings.

    laps : one entry per round: seconds, or tuples and mappings of seconds. Other values are ignored.
    """
    collected = _collected.get()
    if collected is not None and laps:
        collected.rounds.append(len(laps))
        _record_spreads(laps, collected.spreads)


def _record_spreads(laps: Sequence[Any], spreads: list[float]) -> None:
    if len(laps) < 2:
        return
    if isinstance(laps[0], Mapping):
        for name in laps[0]:
            _record_spreads([lap[name] for lap in laps if name in lap], spreads)
    elif isinstance(laps[0], tuple):
        for column in zip(*laps):
            _record_spreads(column, spreads)
    elif isinstance(laps[0], float) and median(laps) >= SHORTEST:
        spreads.append((max(laps) - min(laps)) / median(laps))


def summary_of(spreads: Sequence[float]) -> dict[str, float]:
    """The number of timings, and the median and ninth decile of their spreads; empty without repeated timings."""
    if not spreads:
        return {}
    ninth = quantiles(spreads, n=10, method="inclusive")[-1] if len(spreads) > 1 else spreads[0]
    return {"timings": len(spreads), "median": median(spreads), "ninth_decile": ninth}
