"""Checks of the arguments of procedural scenes."""

from ...checks import whole_number

LEAST, MOST = 1_000, 400_000_000
"""The limits of the number of triangles."""


def checked(name: str, triangles, seed) -> tuple[int, int]:
    """`triangles` and `seed` of the scene `name` as integers. Raises InputError if one is invalid."""
    where = f"procedural scene {name}:"
    return (
        whole_number(triangles, f"{where} triangles", LEAST, MOST),
        whole_number(seed, f"{where} seed", 0, 2**63 - 1),
    )
