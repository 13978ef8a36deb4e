"""Shadows on the ground, as polygons: at a moment, or the hours of shadow of days.

- `shadow`: `shadow`, on a plane or on a raster of cells
- `shadow_options`: options of `shadow`
- `plane_projection`: exact projection of triangles along the sun to a horizontal plane
- `shadow_polygons`: the result, and its files; `shadow_map`: its map sheet
"""
