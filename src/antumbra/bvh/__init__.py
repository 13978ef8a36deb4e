"""Bounding volume hierarchies: nodes, builders, and measures of quality.

- nodes, blocks, wide: three forms of a tree; widen, relayout, assemble: from one form to another
- binned_sah, sweep_sah (bins, sweep, splits, top_down, top, subtree): surface area heuristic, top-down
- morton, radix_sort, lbvh, treelet, tl_lbvh: Morton codes and treelet restructuring
- srdh, srdh_top, srdh_cost, rayset: trees for sampled shadow rays; order, rayorder: orders of children
- reinsertion: optimisation of finished trees; refit: update of the last frame's tree; kept: its part without
  the triangles that culling drops
- quality, bounds, cut, smallest, prepare: shared by the other modules
"""
