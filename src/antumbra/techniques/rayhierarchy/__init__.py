"""Improved ray hierarchies [Olsson and Assarsson 2011]: a hierarchy over the shadow rays, none over the scene.

- `ray_hierarchy`: `trace_shadow`, and the choice for wide lights
- `light_beams`: beams, their projection, their active receivers
- `receiver_order`: sorting keys and order of receivers
- `leaf_packing`: receivers to leaves
- `ray_leaves`: the rays in leaves, ray tests, scratch memory
- `ray_tree`: the implicit tree, and the interface of its nodes
- `shadow_planes`: triangles as planes and rows of numbers
- `box_nodes`: nodes as boxes
- `shaft_hierarchy`: nodes as shafts, traversal by clusters of triangles
- `triangle_traversal`: traversal by single triangles, good occluders first
"""
