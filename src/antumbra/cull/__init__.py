"""Culling before a BVH is built: triangles that no shadow ray can meet are dropped [Selgrad et al. 2015].

- cull: the steps in order; grid: cells over the box of all segments
- sources, targets: cells of receivers and of lights; swept: cells between them
- relevance: triangles in marked cells
"""
