"""Single rays and packets, without the structure of a shadow query.

- `ray_traversal`: any-hit and closest-hit traversal of the binary BVH, child orders
- `wide_traversal`: the eight-wide BVH: `RayBlock`, box and triangle tests
- `packet_extents`: which rays are coherent, and the extents of their origins and directions
- `packet_lines`: triangles that all rays of a packet miss
- `ray_packet`: packets of coherent rays through the wide BVH
- `interleaved_rays`: incoherent rays through the wide BVH
- `single_rays`: the tracer `single`, step counts
- `row_tiles`: batches of eight by eight rays, where a list holds a picture row by row
- `ray_batches`: ray arrays, for `Scene.occluded` and `Scene.closest_hit`
- `hit_reports`: t and weights of hits, sixteen at a time
- `all_hits`: all hits of ray arrays, or their number
- `inside_votes`: whether points are inside open surfaces, by rays through their caps
- `cell_verdicts`: whether points are inside surfaces, by the cells of an occupancy grid
- `instance_traversal`: one ray through instances
- `instance_batches`: ray lists through instances, interleaved
- `instance_rays`: all hits and shadow queries of instances
- `ray_hits`: nearest surfaces of diffuse rays, all intersections of segments
"""
