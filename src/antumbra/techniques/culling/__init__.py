"""Pre-BVH culling: drop the triangles that no shadow ray can meet [Selgrad et al. 2015].

- `pre_bvh_culling`: `cull`, and the input of builders and of tracers without a BVH
- `culling_grid`: the grid, boxes of receivers and lights, and the cells between them
"""
