"""CHC+RT: hierarchical occlusion culling for rays of any kind [Mattausch et al. 2015], in core and out of core.

- `chc_rt`: `trace_shadows`, `camera_hits`, `nearest_hits`, `ray_hits`, `nearest_scheduled`
- `occlusion_queries`: screen tiles, cells of 16 rays, bundles, `ask`
- `tree_parts`: subtrees that are traced whole, and the lists of each tile
- `visibility_fronts`: fronts of query pairs, and Algorithm 1
- `ray_bundles`: segments, passes and camera rays as cells and bundles
- `nearest_hits`: nearest hits through lists of parts
- `picture_ray_sets`: the ray sets of a picture
"""
