"""Culling before a BVH is built: drops the triangles that no shadow ray can meet [Selgrad et al. 2015].

- cull: the steps in order
- grid: cells over the box of all segments
- sources, targets: boxes of receivers and of lights
- swept: cells between sources and targets
- relevance: triangles in marked cells
"""
