"""Multi-frusta tracing [Benthin and Wald 2009], with shafts from 16 receivers to the whole light.

- `multi_frusta`: `trace_shadow`, threads and bundles
- `bundle`: the 16 lanes of a bundle and their traversal
- `tile_clusters`: regions, clusters and the choice of tile groups
- `tile_group`: tiles traced as one
- `tile_lanes`: block tests of a tile group, compaction of rays
- `reverse_frusta`: frusta from light points to a tile group
- `sample_frusta`, `frusta_areas`: frusta of 16 receivers and one light sample
- `shaft_culling`: shafts and beams against triangles and blocks
"""
