"""Pre-BVH culling as published [Selgrad et al. 2015].

- `cell_marking`: marks grid cells as published, and a convex region for comparison
- `culling_measurements`: views and measurements
- `culling_tables`: prints the tables with the published results, and draws Figure 7
"""
