"""CHC+RT: hierarchical occlusion culling for rays of any kind [Mattausch et al. 2015], in core and out of core.

- trace: `trace_shadow`, `camera_hits`, `nearest_hits`; options: what can be chosen
- parts, tiles, cells: subtrees, tiles of the screen, and 4 x 4 rays at a time
- queries, fronts, schedule: occlusion queries, what was visible, and Algorithm 1
- nearest, camera, surfaces: closest hits through parts
"""
