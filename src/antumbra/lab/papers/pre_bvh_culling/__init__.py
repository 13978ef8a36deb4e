"""Pre-BVH culling as published [Selgrad et al. 2015].

- `cell_marking`: marks grid cells along lines between cells, as published
- `light_cells`: the cells that overlap a light
- `convex_region`: marks a convex region, for comparison
- `culling_published`: the paper's results
- `culling_views`: its views, random views, and an animation
- `culling_measurements`: measurements
- `culling_tables`: prints the tables with the published results
- `culling_charts`: draws the results, Figures 2 to 7
"""
