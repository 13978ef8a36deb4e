"""CHC+RT: hierarchical occlusion culling for rays of any kind [Mattausch et al. 2015], in core and out of core.

- trace: `trace_shadows`, `camera_hits`, `nearest_hits`, `ray_hits`; options: `Options`
- parts, tiles, cells: subtrees that are traced whole, tiles of the screen, and cells of 16 rays
- segments, passes, camera, bundles: the rays of each kind, as cells and one by one
- queries, fronts, lists, schedule: occlusion queries, the visible and invisible fronts, and Algorithm 1
- raysets: ray sets, and several of them as one question; nearest: closest hits through parts
- hits, surfaces: the triangles that rays hit, and the surfaces that they see
"""
