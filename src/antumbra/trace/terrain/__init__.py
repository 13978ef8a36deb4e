"""Rays over rasters of heights, whose triangles are not stored.

- `terrain_rays`: shadow rays; `terrain_ray_lists`: ray lists
- `terrain_stencils`, `terrain_lanes`: parallel rays from the cells, 16 at a time
- `bordered_terrain`: both for rasters larger than memory
"""
