"""CHC+RT: hierarchical occlusion culling for rays of any kind [Mattausch et al. 2015], in core and out of core.

- `chcrt_tracer`: the tracer, as registered
- `chc_rt`: its state: shadow queries, camera rays and other nearest-hit rays
- `occlusion_queries`: screen tiles, cells of 16 receivers, ray bundles, occlusion queries
- `tree_parts`: the tree cut into a top tree and subtrees, and the subtree list of each tile
- `visibility_fronts`: query pairs, their fronts, and Algorithm 1
- `ray_bundles`: cells and bundles of shadow segments, ray passes and camera rays
- `nearest_hits`: nearest hits through lists of subtrees
- `picture_ray_sets`: the ray sets of an image
- `device_parts`: rays on a device, and `device_residency`: its memory as a cache of parts
"""
