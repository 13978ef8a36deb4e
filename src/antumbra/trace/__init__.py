"""Tracers: each answers a ShadowQuery over a BVH, and all give the same bits."""
