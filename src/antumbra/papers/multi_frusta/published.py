"""Figures that [Benthin and Wald 2009] published."""

COLUMNS = ("triangles", "candidates", "box_tests", "triangle_tests")
"""Names of our counters for the paper's #tris, +culling, #AABB and #isec."""

TABLE1 = ("1.9-3.7", "5.0-10.1", "14.1-23.8", "1.0-1.4", "3.3-6.1")
"""The S rows, ranges over the paper's scenes: packets of 16 rays divided by multi-frusta, for COLUMNS and seconds."""

PRIMARY = ("1.5-2.3", "3.0-9.5", "11.8-21", "1.7-3.1", "3.4-7.8")
"""The same for the P rows of Table 1: primary rays without shading."""

PACKET256 = "-3 to -4 %", "at most 0.5"
"""Sec. 5.2: what packets of 256 rays change in box tests beside multi-frusta, and how many times as fast they are."""

EDGES = 0.115
"""Figure 7: the share of pixels at silhouettes, in the scene Saloon."""

TABLE2 = {
    "multifrusta:paper": "0 0 0 0",
    "multifrusta:leaf-boxes": "-15 -19 +155 -26",
    "multifrusta:corners": "0 -14 0 -21",
    "multifrusta:full": "-8 -18 -2 -23",
}
"""Changes of COLUMNS in per cent, in the scene T-Rex."""
