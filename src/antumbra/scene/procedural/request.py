"""What may be asked for."""

from ...errors import InputError

LEAST, MOST = 1_000, 400_000_000
"""How many triangles may be asked for."""


def checked(name: str, triangles, seed) -> tuple[int, int]:
    """`triangles` and `seed` of the scene `name` as integers, or InputError."""
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
