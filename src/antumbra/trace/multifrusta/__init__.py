"""Multi-frusta tracing [Benthin and Wald 2009], with shafts from 16 receivers to the whole light.

- trace: `trace_shadow`, threads and tiles
- bundle, region: the shafts of a tile, and of a region of tiles, with their traversal of the BVH
- tilegroup, compaction: leaves against groups of shafts; rays that are left, side by side
- shaftbox, shaftcull, shaftleaf: shafts against boxes and triangles
"""
