"""Sources: where the triangles of a scene are, and how rays and pictures reach them.

- `source_protocols`: what an engine needs of a scene, one protocol per concern
- `in_memory_source`: scenes in memory, and their ray lists
- `instanced_source`: scenes of instances
- `paged_source`: scenes in stores: bands, ray lists, trees
- `paged_views`: small images of scenes in stores
- `paged_hits`: all hits of ray lists in stores
- `point_shadows`: shadow rays of points through trees
- `terrain_shadows`: points and ray lists over rasters of heights, without a tree
- `device_ray_lists`: ray lists on a device
- `card_rays`: ray lists of the plan `auto` on a card, once that pays
"""
