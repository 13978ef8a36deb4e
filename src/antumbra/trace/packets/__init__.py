"""Packets of 16 or 64 shadow rays, coherent or incoherent.

- `ray_tile`: the rays of a tile of receivers, and the queries for which packets are better than shafts
- `packet16`: the tracer, from 16 receivers to a stratum of the light, or from one receiver to its samples
- `wide_packets`: the tracers `wide` and `wide:samples`, packets of 64 rays through the wide BVH
"""
