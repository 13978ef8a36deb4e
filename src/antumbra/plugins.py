"""Packages that add to a registry: each announces a function under an entry point, as pyproject.toml does."""

from functools import cache
from importlib.metadata import entry_points


@cache
def add(group: str) -> None:
    """Call every function announced under a group of entry points; once per process."""
    for point in entry_points(group=group):
        point.load()()
