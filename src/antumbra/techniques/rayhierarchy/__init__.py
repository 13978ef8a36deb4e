"""Improved ray hierarchies [Olsson and Assarsson 2011]: a hierarchy over the shadow rays, and none over the scene.

- `cone_tracer`: the tracer, as registered
- `ray_hierarchy`: `trace_shadow`, and the choice of traversal for wide lights
- `light_beams`: beams of segments, their projection, their active receivers
- `receiver_order`: sorting keys and order of receivers
- `leaf_packing`: packing of receivers into leaves
- `pixel_blocks`: blocks of 4 x 4 pixels as leaves
- `ray_leaves`: the rays in leaves, ray-triangle tests, scratch memory
- `ray_tree`: the implicit tree, and the interface of its node classes
- `shadow_planes`: the shadow planes of triangles, and rows of triangle data
- `box_nodes`: boxes as nodes
- `projected_rays`: rays to one point, and their tests by shadow planes
- `shaft_hierarchy`: shafts as nodes, and their traversal by clusters of triangles
- `triangle_traversal`: traversal by single triangles, good occluders first
"""
