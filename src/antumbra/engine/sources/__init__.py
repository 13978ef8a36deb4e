"""Sources: where the triangles of a scene are, and how rays and pictures reach them.

- `in_memory_source`: scenes in memory, and their ray lists
- `instanced_source`: scenes of instances
- `paged_source`: scenes in stores: bands, ray lists, trees
- `paged_hits`: all hits of ray lists in stores
- `terrain_shadows`: queries at points over rasters of heights, without a tree
"""
