"""Packets of 16 rays, coherent or not.

- packet16: from 16 receivers to a stratum of the light, or from one receiver to its samples
- raytile: the rays of a tile of receivers; incoherent: queries that packets trace better than shafts
"""
