"""What [Benthin and Wald 2009] published: the ranges over its scenes."""

COLUMNS = ("triangles", "candidates", "box_tests", "triangle_tests")
"""The paper's #tris, +culling, #AABB and #isec, as our counters name them."""

TABLE1 = ("1.9-3.7", "5.0-10.1", "14.1-23.8", "1.0-1.4", "3.3-6.1")
"""How many times less than packets of 16 rays: each of COLUMNS, and seconds."""

TABLE2 = {
    "multifrusta:paper": "0 0 0 0",
    "multifrusta:leaf-boxes": "-15 -19 +155 -26",
    "multifrusta:corners": "0 -14 0 -21",
    "multifrusta:full": "-8 -18 -2 -23",
}
"""Change of COLUMNS in %, in the scene T-Rex."""
