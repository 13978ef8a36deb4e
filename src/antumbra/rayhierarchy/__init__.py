"""Improved ray hierarchies [Olsson and Assarsson 2011]: over the shadow rays, and none over the scene.

- trace: `trace_shadow`; options: what can be chosen; soup: the triangles
- beams, asking, rays, packed, order, keys, blocks: rays of one light, sorted, as leaves
- nodes, tree, boxes, boxrows, pointrows, planes, rows, view: the hierarchy, and what is tested of a triangle
- traverse, leaf, occluders: triangles through the hierarchy, good occluders first
- wide, shafts, shaftrays, clusters: lights as large as what they light; memory: arrays that are used again
"""
