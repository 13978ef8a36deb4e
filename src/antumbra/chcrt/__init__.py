"""CHC+RT: hierarchical occlusion culling for rays of any kind [Mattausch et al. 2015], in core and out of core.

- trace: `trace_shadow`, `camera_hits`, `nearest_hits`; options: `Options`
- parts, tiles, cells: subtrees that are traced whole, tiles of the screen, and cells of 4 x 4 rays
- queries, fronts, schedule: occlusion queries, the visible and invisible fronts, and Algorithm 1
- nearest, camera, surfaces: closest hits through parts, the camera's rays, and the surfaces that rays see
"""
