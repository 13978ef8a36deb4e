"""What the report on ray hierarchies published [Olsson and Assarsson 2011, Sec. 5, Tables 1 and 2].

It measured at 1024 x 1024 pixels on an NVIDIA GTX 580.
"""

from collections.abc import Mapping
from enum import StrEnum


class RayHierarchyTable(StrEnum):
    """The tables that the benchmark measures."""

    pictures = "pictures"
    film = "film"


# --- Published results ------------------------------------------------------------------------------------------------


VARIANTS = ("Spheres", "SpheresSorted", "Precise", "PreciseSorted", "PreciseSEA", "PreciseEATP", "PreciseSEATP")
"""Table 1: sphere tests or precise tests; rays in image order or sorted (S); early accept (EA); two passes (TP)."""

MEASURED = VARIANTS[:4]
"""The variants of Figure 6 and Table 2. Figure 7 compares the others with PreciseSorted."""

FIGURE7 = VARIANTS[3:]
"""The variants of Figure 7: fewer nodes, but more time."""

NODES = {
    "Spheres": (19.89e6, 317.91e6, 5.77e6, 2199.22e6),
    "SpheresSorted": (2.66e6, 6.79e6, 5.40e6, 6.60e6),
    "Precise": (17.58e6, 292.84e6, 2.25e6, 2163.30e6),
    "PreciseSorted": (0.82e6, 2.24e6, 2.20e6, 1.97e6),
}
"""Table 2: visited nodes in four views of the museum. The third has the most screen coherence, the last the least."""

MILLISECONDS = {
    "Spheres": (29.40, 446.10, 10.53, 3771.55),
    "SpheresSorted": (11.90, 16.75, 15.05, 16.69),
    "Precise": (38.50, 557.91, 8.26, 4172.61),
    "PreciseSorted": (10.65, 13.40, 12.63, 12.60),
}
"""Table 2: shadow times in the same views, in milliseconds."""

ROBOTS_FRAMES, ROBOTS_SECONDS = 800, 50.0
"""BART's animation of the robots: frame k is at k * 50 / 799 s."""

CORRIDOR, ROBOT, WALL = 100, 160, 500
"""Frames of the robots: the corridor of Section 5, frame 160, and the camera straight at a wall.

Section 5 has the camera straight at a wall "around frame 160". At BART's rate of 16 frames per second, a robot stands
before the wall then, and a wall fills the picture from frame 496 to 508, so the report must count its frames otherwise.
"""

WALL_NODES = {"Spheres": 50e6, "Precise": 200.0}
"""Visited nodes at the wall, in the text of Section 5: "close to 50 million" and "a couple of hundred".

All 71,706 triangles are tested at the root, so these must be nodes that triangles pass, not all nodes tested."""


def ratios(slow: str, fast: str, table: Mapping[str, tuple[float, ...]] = NODES) -> list[float]:
    """The ratios of two rows of Table 2, one per view."""
    return [a / b for a, b in zip(table[slow], table[fast])]
