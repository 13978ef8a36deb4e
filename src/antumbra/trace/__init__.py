"""Tracers: they answer a ShadowQuery, over a BVH, all with the same bits."""
