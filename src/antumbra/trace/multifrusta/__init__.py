"""Multi-frusta tracing [Benthin and Wald 2009], with shafts from 16 receivers to the whole light.

- trace: `trace_shadow`, threads, bundles, and their traversal of the BVH
- bundle, region: the 16 lanes of a bundle; regions of 16 tiles, cut into parts that are traced together
- tilegroup, compaction: tiles that share a walk; their rays gathered into full vectors
- shaftbox, shaftcull, shaftleaf: shafts and beams against boxes, triangles, and blocks of triangles
"""
