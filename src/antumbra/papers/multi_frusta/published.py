"""Figures that [Benthin and Wald 2009] published."""

COLUMNS = ("triangles", "candidates", "box_tests", "triangle_tests")
"""Names of our counters for the paper's #tris, +culling, #AABB and #isec."""

TABLE1 = ("1.9-3.7", "5.0-10.1", "14.1-23.8", "1.0-1.4", "3.3-6.1")
"""Ranges over the paper's scenes: packets of 16 rays divided by multi-frusta, for each of COLUMNS and for seconds."""

TABLE2 = {
    "multifrusta:paper": "0 0 0 0",
    "multifrusta:leaf-boxes": "-15 -19 +155 -26",
    "multifrusta:corners": "0 -14 0 -21",
    "multifrusta:full": "-8 -18 -2 -23",
}
"""Changes of COLUMNS in per cent, in the scene T-Rex."""
