"""Tracers: each answers a `ShadowQuery` over a BVH, and all give bit-identical answers.

- `tracer`: the base class of tracers, the forms of a tree, and the registry; `tracer_cost`: what tracers cost
- `frusta/`: multi-frusta tracing, the default
- `packets/`: packets of 16 rays
- `rays/`: single rays, and ray lists over the eight-wide BVH
- `primary/`: camera rays
- `closest_points`: the closest points of a scene's faces
- `terrain/`: rays over rasters of heights
- `tile`: queries as tiles of 16 receivers and chunks of 16 samples
- `light_table`: light samples in strata
- `shafts`: shafts, beams and segments of a tile against boxes
- `horizon`: samples below a receiver's own surface
- `descent`: slab tests of 16 lanes, traversal of one tree
- `tree_list`: trees traversed one after another, and `walk_tree`, the step that each tracer defines
- `triangle_tests`: float32 tests of 16 rays against a triangle, deferred tests
- `alpha_cutouts`: alpha-masked faces, tested after the solid triangles
- `counters`: exact operation counts
"""
