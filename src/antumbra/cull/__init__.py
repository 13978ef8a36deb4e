"""Culling before a BVH is built: triangles that no shadow ray can meet are dropped."""
