"""Packages that add to a registry: each announces a function under an entry point, as pyproject.toml does."""

from functools import cache
from importlib.metadata import EntryPoint, entry_points
from threading import RLock

_lock = RLock()
_added: set[str] = set()


@cache
def announced(group: str) -> dict[str, EntryPoint]:
    """Name -> entry point of a group, in the order of the names."""
    return {point.name: point for point in sorted(entry_points(group=group))}


def add(group: str) -> None:
    """Call every function announced under a group of entry points; once per process, whichever thread asks first."""
    with _lock:
        if group in _added:
            return
        _added.add(group)  # first, for a function that looks something up while it adds
        try:
            for point in announced(group).values():
                point.load()()
        except BaseException:
            _added.discard(group)  # so that whoever asks next hears it too
            raise
