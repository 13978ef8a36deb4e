"""Checks of the arguments of procedural scenes."""

from ...errors import InputError

LEAST, MOST = 1_000, 400_000_000
"""The limits of the number of triangles."""


def checked(name: str, triangles, seed) -> tuple[int, int]:
    """`triangles` and `seed` of the scene `name` as integers. Raises InputError if one is invalid."""
    return _whole(name, "triangles", triangles, LEAST, MOST), _whole(name, "seed", seed, 0, 2**63 - 1)


def _whole(name: str, what: str, value, least: int, most: int) -> int:
    try:
        number = int(value)
        fits = number == value and least <= number <= most
    except (TypeError, ValueError, OverflowError):
        fits = False
    if not fits:
        raise InputError(f"procedural scene {name}: {what} is {value!r}; give a whole number from {least} to {most}")
    return number
