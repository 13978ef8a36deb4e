"""Improved ray hierarchies [Olsson and Assarsson 2011]: a hierarchy over the shadow rays, and none over the scene.

- trace: `trace_shadow`; options: its options; soup: the triangles
- beams, asking, rays, packed, order, keys, blocks: the rays of one light, sorted into leaves
- nodes, tree, boxes, boxrows, pointrows, planes, rows, view: the hierarchy, and the triangle data of node tests
- traverse, leaf, occluders: the traversal by triangles, good occluders first
- wide, shafts, shaftrays, clusters: lights as large as the lit surfaces; memory: reused arrays
"""
