"""Single rays and packets, without the structure of a shadow query.

- `ray_traversal`: the binary BVH, for any-hit and closest-hit rays; orders of children
- `wide_traversal`: the eight-wide BVH: `RayBlock`, box and triangle tests
- `ray_packet`: packets of coherent rays through the wide BVH
- `single_rays`: interleaved rays, the tracers `single` and `wide`, step counts
- `ray_batches`: arrays of rays, for `Scene.occluded` and `Scene.closest_hit`
- `ray_hits`: surfaces that diffuse rays meet, all triangles that segments meet
"""
