"""Pre-BVH culling as published [Selgrad et al. 2015].

- `cell_marking`: marks grid cells as published, and a convex region for comparison
- `culling_measurements`: views, published figures, measurements, tables and the plot
"""
