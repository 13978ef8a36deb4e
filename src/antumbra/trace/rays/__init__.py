"""Rays one by one and in packets, without a shadow query's structure.

- traverse, orders: the walk of a binary BVH for any-hit and closest-hit rays; the orders of children
- single: shadow queries ray by ray (`single`, `wide`); steps: the same, with each step counted
- wide, rayblock, packetbox, raypacket, interleaved: the eight-wide BVH, by packets or interleaved rays
- batch: arrays of rays, for `Scene.occluded` and `Scene.closest_hit`
- bounce, intersections: the surfaces that diffuse rays meet; all triangles that segments meet
"""
