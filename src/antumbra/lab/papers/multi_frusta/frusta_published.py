"""The figures of "Efficient ray traced soft shadows using multi-frusta tracing" [Benthin and Wald 2009].

The paper contradicts itself in a few places (see `contradictions`); these are its tables as printed.
"""

from enum import StrEnum
from typing import NamedTuple


class FrustaTable(StrEnum):
    """The tables that the benchmark measures."""

    primary = "primary"
    soft = "soft"
    hard = "hard"
    shrinking = "shrinking"
    quality = "quality"
    sizes = "sizes"
    lights = "lights"


# --- Published results ------------------------------------------------------------------------------------------------


COUNTERS = {"triangles": "#tris", "candidates": "+culling", "box_tests": "#AABB", "triangle_tests": "#isec"}
"""Our counters by the names of the paper's columns."""


class PublishedRow(NamedTuple):
    """A row of Table 1: thousands of each counter, and millions of simulated cycles."""

    scene: str
    rays: str  # P: primary rays; S: primary and soft shadow rays, shading and filtering
    frusta: bool  # multi-frusta, otherwise packets of 16 rays
    triangles: int
    candidates: int
    box_tests: int
    triangle_tests: int
    cycles: float
    with_shading: float | None = None  # P rows only

    @property
    def name(self) -> str:
        """The row's label in the paper."""
        return f"{self.rays}-{'Frusta' if self.frusta else 'Packet'}"


TABLE1 = (
    PublishedRow("T-Rex", "P", False, 399, 399, 1218, 399, 94.1, 104.3),
    PublishedRow("T-Rex", "P", True, 173, 42, 58, 125, 19.5, 29.6),
    PublishedRow("T-Rex", "S", False, 10957, 7298, 36234, 7698, 2572.0),
    PublishedRow("T-Rex", "S", True, 3575, 725, 1518, 5527, 635.0),
    PublishedRow("Fern", "P", False, 655, 466, 2408, 466, 163.9, 175.2),
    PublishedRow("Fern", "P", True, 414, 156, 204, 315, 47.9, 58.6),
    PublishedRow("Fern", "S", False, 15882, 8277, 34197, 10801, 3272.0),
    PublishedRow("Fern", "S", True, 4325, 1668, 2414, 10606, 977.5),
    PublishedRow("Saloon", "P", False, 383, 278, 5839, 278, 246.9, 257.4),
    PublishedRow("Saloon", "P", True, 204, 34, 388, 150, 31.5, 42.2),
    PublishedRow("Saloon", "S", False, 5332, 3209, 81023, 3209, 2672.0),
    PublishedRow("Saloon", "S", True, 2730, 340, 5419, 2218, 437.0),
    PublishedRow("Fairy Forest", "P", False, 587, 524, 3651, 524, 209.0, 222.5),
    PublishedRow("Fairy Forest", "P", True, 403, 111, 235, 312, 49.5, 63.2),
    PublishedRow("Fairy Forest", "S", False, 6556, 4290, 51765, 4290, 2535.0),
    PublishedRow("Fairy Forest", "S", True, 3461, 775, 3121, 3874, 637.0),
)
"""Table 1: 1024 x 1024 pixels, 16 shadow rays per pixel, one simulated core of 1 GHz."""

Pair = tuple[PublishedRow, PublishedRow]
"""The rows of a scene: packets, and frusta."""

FACTORS = {
    ("T-Rex", "P"): "2.3 9.5 21 3.1 4.82 3.52",
    ("T-Rex", "S"): "3.06 10.06 23.8 1.39 4.05",
    ("Fern", "P"): "1.58 2.98 11.8 2.08 3.42 2.98",
    ("Fern", "S"): "3.67 4.96 14.1 1.01 3.34",
    ("Saloon", "P"): "1.86 8.17 15.04 1.85 7.83 6.09",
    ("Saloon", "S"): "1.95 9.43 14.95 1.44 6.11",
    ("Fairy Forest", "P"): "1.45 4.61 15.5 1.67 4.2 3.52",
    ("Fairy Forest", "S"): "1.89 5.53 16.58 1.1 3.97",
}
"""Table 1, the rows Reduction as printed, in the order of FACTOR_FIELDS. Their last digits are cut off, not rounded."""

FACTOR_FIELDS = (*COUNTERS, "cycles", "with_shading")

PIXELS, SPP = 1024 * 1024, 16


def pairs(rays: str) -> list[Pair]:
    """The (packets, frusta) rows of the scenes; rays: P or S."""
    rows = [row for row in TABLE1 if row.rays == rays]
    return list(zip(rows[::2], rows[1::2]))


def shadow_factors(primary: Pair, both: Pair) -> dict[str, float]:
    """The factors of a scene's S rows without its primary rays and their shading, by the names of the fields."""
    factors = {}
    for field in (*COUNTERS, "cycles"):
        packets, frusta = (getattr(s, field) - getattr(p, _PRIMARY.get(field, field)) for p, s in zip(primary, both))
        factors[field] = packets / frusta
    return factors


_PRIMARY = {"cycles": "with_shading"}
"""Field of an S row -> the field of a P row that it includes, if it has another name."""


def printed_factor(pair: Pair, field: str) -> str:
    """A factor of a row Reduction of Table 1, as printed."""
    return FACTORS[pair[0].scene, pair[0].rays].split()[FACTOR_FIELDS.index(field)]


def contradictions() -> list[tuple[str, str]]:
    """Where the paper contradicts itself: place -> explanation. First its factors that do not follow from its rows."""
    found = []
    for pair in (*pairs("P"), *pairs("S")):
        packets, frusta = pair
        for field, name in COUNTERS.items():
            printed = printed_factor(pair, field)
            own = getattr(packets, field) / getattr(frusta, field)
            if abs(own - float(printed)) >= 10.0 ** -len(printed.partition(".")[2]):
                place = f"{packets.scene}, {packets.rays}, {name}"
                found.append((place, f"the factor is printed as {printed}, but the rows give {own:.2f}"))
    return [*found, *_OTHER_CONTRADICTIONS]


_OTHER_CONTRADICTIONS = (
    ("T-Rex, S-Packet", "7,298K triangles after culling, but 7,698K tests, though no triangle is culled after that"),
    ("Table 2, corners", "-13.9 % is printed, but 512K of 613K are -16.5 %"),
    ("Sec. 5.1", "the text gives 1.58 to 3.67 for triangles, though Fairy Forest has 1.45"),
)


PACKET256 = "-3 to -4 %", "at most 0.5"
"""Sec. 5.2: packets of 256 rays relative to multi-frusta: change in box tests, and speedup."""

EDGES = 0.115
"""Figure 7: share of pixels at silhouettes, in the scene Saloon."""

TABLE2 = {
    "multifrusta:paper": "0 0 0 0",
    "multifrusta:leaf-boxes": "-15 -19 +155 -26",
    "multifrusta:corners": "0 -14 0 -21",
    "multifrusta:full": "-8 -18 -2 -23",
}
"""Changes of COUNTERS in per cent, in the scene T-Rex."""

FIGURE6 = "linear in the size of the light"
"""Figure 6: growth of triangles accessed and of tests. The paper does not say whether size means edge or area."""
