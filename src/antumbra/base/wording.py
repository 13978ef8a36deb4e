"""Counts and places in messages: nouns and verbs that agree with their number, and rounded coordinates."""

from collections.abc import Iterable
from typing import SupportsIndex

_ES = ("s", "x", "z", "ch", "sh")
_NOUNS = {"vertex": "vertices", "index": "indices", "axis": "axes", "leaf": "leaves"}
_VERBS = {"have": "has", "are": "is", "do": "does"}


def counted(n: SupportsIndex, noun: str, verb: str = "") -> str:
    """A number and its noun, such as ``1 point`` and ``2,500 points``, and the verb that agrees with it.

    noun : in the singular
    verb : in the plural, perhaps with what follows it: ``counted(1, "point", "lie below")`` is ``1 point lies below``
    """
    return f"{n.__index__():,} {noun if n.__index__() == 1 else plural(noun)}" + (
        f" {agreeing(n, verb)}" if verb else ""
    )


def some_of(n: SupportsIndex, total: SupportsIndex, noun: str, verb: str = "") -> str:
    """Some of a number of things, such as ``1 of 20 points lies below``, where `verb` is ``lie below``."""
    return f"{n.__index__():,} of {counted(total, noun)}" + (f" {agreeing(n, verb)}" if verb else "")


def plural(noun: str) -> str:
    """The plural of a noun in English, of its last word."""
    before, space, last = noun.rpartition(" ")
    if last in _NOUNS:
        last = _NOUNS[last]
    elif last.endswith(_ES):
        last += "es"
    elif last.endswith("y") and last[-2:-1] not in ("a", "e", "o", "u"):
        last = f"{last[:-1]}ies"
    else:
        last += "s"
    return before + space + last


def agreeing(n: SupportsIndex, verb: str) -> str:
    """Words that begin with a verb in the plural, whose form agrees with `n`: ``lie below`` or ``lies below``."""
    if n.__index__() != 1:
        return verb
    first, space, rest = verb.partition(" ")
    return _VERBS.get(first, f"{first}s") + space + rest


def percent(share: float, decimals: int = 1) -> str:
    """A share as text, such as ``37.5 %``."""
    return f"{100.0 * share:.{decimals}f} %"


def place_text(point: Iterable[float]) -> str:
    """Coordinates of a point, ``x,y,z``, to six digits of the largest, and at least to a thousandth of a unit."""
    coordinates = [float(c) for c in point]
    largest = max((abs(c) for c in coordinates), default=0.0)
    decimals = max(3, 5 - exponent_of_ten(largest))
    return ",".join(f"{round(c, decimals) + 0.0:.15g}" for c in coordinates)


def exponent_of_ten(number: float) -> int:
    """That of a number written as 1.5e-3, found without the rounding of a logarithm; 0 of zero."""
    return int(f"{number or 1.0:e}".partition("e")[2])


def height_text(height: float, size: float) -> str:
    """A height in a scene of a size, in the same unit, rounded to at most a thousandth of the size."""
    decimals = max(0, 3 - exponent_of_ten(size))
    return f"{round(height, decimals) + 0.0:.15g}"
