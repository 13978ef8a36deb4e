"""Summaries of results: names and numbers for programs, and the same numbers as lines and a table for people."""

from collections.abc import Mapping, Sequence
from types import MappingProxyType
from typing import Any, NamedTuple


class SummaryTable(NamedTuple):
    """A table for people, of a result with few parts."""

    headers: Sequence[str]
    rows: Sequence[Sequence[str]]
    right: Sequence[int] = ()  # columns of numbers
    leads: bool = False  # whether it comes before the lines


class Summary(NamedTuple):
    """The summary of a result."""

    values: dict[str, Any]  # name -> number or text, for programs
    lines: list[tuple[str, str]]  # names and formatted values, for people
    parts: Mapping[str, Any] = MappingProxyType({})  # name -> records of its parts, if they are few
    table: SummaryTable | None = None
    rays: int | None = None  # number of rays traced, if known


def heading(name: str) -> str:
    """The name of a value as a header."""
    return name.replace("_", " ")


def text_of(value: Any) -> str:
    """A value in a table: numbers with 6 significant digits."""
    return f"{value:,.6g}" if isinstance(value, float) else str(value)


def speed_text(rays: float, seconds: float) -> str:
    """What follows the time or number of rays, such as ``, 3.4 million rays/s``.

    Empty for less than a million rays, whose time is that of the preparation.
    """
    speed = f"{rays / 1e6 / max(seconds, 1e-9):,.1f}"
    return "" if rays < 1e6 or speed == "0.0" else f", {speed} million rays/s"


def duration(seconds: float) -> str:
    """Seconds as text: 12 ms, 3.45 s, 12 min, 1.5 h."""
    if seconds >= 600.0:
        return f"{seconds / 60.0:.0f} min" if seconds < 6000.0 else f"{seconds / 3600.0:.1f} h"
    return f"{seconds:.2f} s" if seconds >= 1.0 else f"{1000.0 * seconds:.3g} ms"
