"""Tracers: each answers a `ShadowQuery` over a BVH, and all give the same bits.

- `frusta/`: multi-frusta tracing, the default
- `packets/`: packets of 16 rays
- `rays/`: single rays, and ray lists over the eight-wide BVH
- `primary/`: the camera's rays
- `tile`: a query cut into tiles of 16 receivers and chunks of 16 samples
- `light_table`: the light samples in strata
- `shafts`: shafts, beams and segments of a tile against boxes
- `horizon`: samples below a receiver's own surface
- `descent`: slab tests of 16 lanes, and the traversal of one tree
- `tree_list`: trees that rays traverse one after another, and `walk_tree`, the step that each tracer defines
- `triangle_tests`: float32 tests of 16 rays and a triangle, deferred tests
- `alpha_test`: faces with holes, after everything else
- `counters`: exact counts of the work
"""
