"""Bounding volume hierarchies: their nodes, the methods that build them, and how good they are.

- nodes, blocks, wide: three forms of a tree; widen, relayout, assemble: from one form to another
- binned_sah, sweep_sah (bins, sweep, splits, top_down, top, subtree): surface area heuristic, top-down
- morton, radix_sort, lbvh, treelet, tl_lbvh: Morton codes, and treelets restructured
- srdh, srdh_top, srdh_cost, rayset: trees for the rays that are shown; order, rayorder: orders of children
- reinsertion, refit: better trees, and trees of the last frame
- quality, bounds, cut, smallest, prepare: parts that these share
"""
