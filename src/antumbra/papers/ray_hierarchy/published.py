"""Figures that the report on ray hierarchies measured on a GPU [Olsson and Assarsson 2011, Sec. 5, Tables 1 and 2]."""

VARIANTS = ("Spheres", "SpheresSorted", "Precise", "PreciseSorted", "PreciseSEA", "PreciseEATP", "PreciseSEATP")
"""Table 1: sphere tests or precise tests; rays in the picture's order or sorted (S); with early accept (EA); with two
passes (TP)."""

MEASURED = VARIANTS[:4]
"""The variants of Figure 6 and Table 2. The others are in Figure 7, beside PreciseSorted."""

FIGURE7 = VARIANTS[3:]
"""The variants of Figure 7: more culling, and more time."""

NODES = {
    "Spheres": (19.89e6, 317.91e6, 5.77e6, 2199.22e6),
    "SpheresSorted": (2.66e6, 6.79e6, 5.40e6, 6.60e6),
    "Precise": (17.58e6, 292.84e6, 2.25e6, 2163.30e6),
    "PreciseSorted": (0.82e6, 2.24e6, 2.20e6, 1.97e6),
}
"""Table 2: cones visited in four views of the museum. The third has the most screen coherence, the last the least."""

MILLISECONDS = {
    "Spheres": (29.40, 446.10, 10.53, 3771.55),
    "SpheresSorted": (11.90, 16.75, 15.05, 16.69),
    "Precise": (38.50, 557.91, 8.26, 4172.61),
    "PreciseSorted": (10.65, 13.40, 12.63, 12.60),
}
"""Table 2: time of the shadows in the same views, in milliseconds."""


def cut(unsorted: str, sorted_: str, table: dict[str, tuple[float, ...]] = NODES) -> float:
    """The ratio of a table without and with sorting, in the view where sorting helps most.

    The report's text says "up to three orders of magnitude fewer nodes" and "over two orders of magnitude faster".
    """
    return max(a / b for a, b in zip(table[unsorted], table[sorted_]))
