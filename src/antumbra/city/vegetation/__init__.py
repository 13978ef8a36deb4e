"""Vegetation: plants as closed crowns on trunks, which let a share of the light pass.

- `vegetation_scenes`: `from_trees`
- `vegetation_table`: plants with heights and radii, from point and polygon layers and CSV files
- `crowns`: the triangles of crowns and trunks
"""
