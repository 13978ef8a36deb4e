"""Pre-BVH culling as published [Selgrad et al. 2015], and for comparison: `lines`, `convex`.

`measure`, `tables` and `plot` make its tables and figures, of the scenes in `views` and `video`.
"""
