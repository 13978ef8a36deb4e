"""Bounding volume hierarchies: nodes, builders, optimisers, refitting, layouts and quality.

- `nodes`: binary and eight-wide nodes, leaves, and accessors of links
- `triangle_bounds`: input checks; boxes and records of triangles
- `morton_sort`: Morton codes and the radix sort
- `binned_split`: the interface of splits, and binned SAH splits
- `top_levels`: the top levels of a build, split by all threads together; assembly of the final tree
- `top_down`: subtrees built by one thread each, and optimal trees over up to four records
- `binned_sah`: the builder `bsah`
- `lbvh`: the builders `lbvh` and `lbvh63`, by Morton codes
- `ploc`: the builder `ploc`, by locally-ordered clustering
- `reinsertion`: the optimiser `reinsert`
- `refit`: the previous frame's tree, refitted to moved triangles or filtered to a subset
- `tree_layout`: depth-first relayout, and the frontier that cuts a tree into parts
- `child_order`: child orders for any-hit rays
- `block_tree`: a shallower tree over blocks of 16 triangles, for ray bundles
- `wide_bvh`: an eight-wide BVH collapsed from a binary one
- `wide_refit`: an eight-wide BVH refitted to moved triangles
- `instance_trees`: a tree per mesh, and one over its copies
- `tree_quality`: validation, SAH cost and statistics
"""
