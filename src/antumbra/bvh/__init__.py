"""Bounding volume hierarchies: nodes, builders, optimisers, refit, layouts and quality.

- `nodes`: binary and eight-wide nodes and leaves, and the accessors of links
- `triangle_bounds`: input checks, boxes and records of triangles
- `morton_sort`: Morton codes and the radix sort
- `binned_split`: the interface of splits, and the binned SAH split
- `top_levels`: the first levels of a build, by all threads; assembly of the final tree
- `top_down`: subtrees that one thread builds, and the optimal trees over four records
- `binned_sah`: the builder `bsah`
- `sweep_sah`: the builder `sweep-sah`
- `lbvh`: the builder `lbvh`, by Morton codes
- `tl_lbvh`: the builder `tl-lbvh`, by treelet restructuring
- `reinsertion`: the optimiser `reinsert`
- `refit`: the tree of the last frame, for moved or for fewer triangles
- `tree_layout`: the depth-first layout of a changed tree, and the frontier that cuts a tree into parts
- `child_order`: orders of children for any-hit rays
- `block_tree`: a shallower tree, with blocks of 16 triangles for ray bundles
- `wide_bvh`: an eight-wide BVH from a binary one
- `tree_quality`: validation, SAH cost and statistics
"""
