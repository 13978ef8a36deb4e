"""Pre-BVH culling: drop the triangles that no shadow ray can meet [Selgrad et al. 2015].

- `pre_bvh_culling`: `cull`, relevant triangles, solid triangles
- `culling_grid`: the grid, boxes of receivers and lights, cells between them
"""
