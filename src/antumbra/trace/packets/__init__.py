"""Packets of 16 rays, coherent or not.

- `ray_tile`: the rays of a tile of receivers, and the queries that packets trace better than shafts
- `packet16`: the tracer, from 16 receivers to a stratum of the light, or from one receiver to its samples
"""
