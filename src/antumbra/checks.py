"""Checked numbers for the public face."""

from collections.abc import Iterable
from difflib import get_close_matches

import numpy as np

from .errors import InputError


def near(name, known: Iterable[str]) -> str:
    """``"did you mean 'x'? "`` if a known name is like `name`, else nothing: for errors about unknown names."""
    text, names = str(name), list(known)
    found = get_close_matches(text, names, 1, 0.6) or [each for each in names if each.lower() == text.lower()][:1]
    return f"did you mean {found[0]!r}? " if found else ""


def vector(value, what: str) -> np.ndarray:
    """Convert `value` to (3,) float64; InputError naming `what` unless it is three finite numbers."""
    try:
        v = np.array(value, np.float64)
    except (TypeError, ValueError):
        raise InputError(f"{what} must be three numbers, not {value!r}") from None
    if v.shape != (3,) or not np.isfinite(v).all():
        raise InputError(f"{what} must be three finite numbers, not {value!r}")
    return v


def whole_number(value, what: str, low: int, high: int) -> int:
    """Convert `value` to an int; InputError naming `what` unless it is a whole number in [`low`, `high`]."""
    try:
        if not isinstance(value, bool) and int(value) == value and low <= value <= high:
            return int(value)
    except (TypeError, ValueError, OverflowError):
        pass
    raise InputError(f"{what} is {value!r}; it must be a whole number from {low} to {high}")


def number(value, what: str, low: float, high: float) -> float:
    """Convert `value` to a float; InputError naming `what` unless low < value < high."""
    try:
        x = float(value)
    except (TypeError, ValueError):
        x = float("nan")
    if not low < x < high:
        raise InputError(f"{what} is {value!r}; it must lie between {low:g} and {high:g}")
    return x


def points(value, what: str) -> np.ndarray:
    """Convert `value` to (m, 3) float64; InputError naming `what` unless all numbers are finite."""
    try:
        found = np.asarray(value, np.float64)
    except (TypeError, ValueError):
        raise InputError(f"{what} must be numbers of shape (m, 3), not {value!r}") from None
    if found.ndim != 2 or found.shape[1] != 3:
        raise InputError(f"{what} must have shape (m, 3), not {found.shape}")
    if not np.isfinite(found).all():
        raise InputError(f"{what} hold NaN or infinity")
    return found
