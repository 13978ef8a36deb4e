"""Packets of 16 rays: coherent ones, and rays that have nothing in common.

- packet16: from 16 receivers to a stratum of the light, or from one receiver to its samples
- raytile: the rays of a tile of pixels; incoherent: lights that are asked all around
"""
