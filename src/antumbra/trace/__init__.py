"""Tracers: each answers a ShadowQuery over a BVH, and all give the same bits.

- multifrusta/: the default tracer, by shafts; packets/: packets of 16 rays
- rays/: rays one by one and over the eight-wide BVH; primary/: the camera's rays
- querychunk, tile, lighttable: a query cut into tiles of 16 receivers and chunks of 16 light samples
- shafts, beams: the volumes from a tile's receivers to its samples; horizon: samples below a receiver's own surface
- forest: the trees that rays go through one after the other, and `walk_tree`, the step that each tracer defines
- descent, slabs: the way down one tree to its leaves, and 16 box tests at once
- cutouts, texels: faces with holes, after everything else
- blocktest, raytest, segmentbox: tests of a ray and a block, of 16 rays and a triangle, and of 16 rays and a box
- deferred: tests that float32 cannot decide; counters: exact counts of the work
"""
