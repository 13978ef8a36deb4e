"""Procedural scenes of any size, without files: atrium, city, forest, and scenes registered by other packages.

This module imports nothing, so that `generated_scene` can be imported without the generators.

- `generated_scene`: procedural scenes as scene data, and the city as a stream
- `procedural_scenes`: the registry of scenes, and `generate`
- `atrium`: a courtyard with arcades
- `city`: streets, towers and houses, in one piece or streamed block by block
- `forest`: a path through a forest
- `props`: plants, trees and furniture
- `shapes`: small closed meshes, and instanced copies of them
- `palette`: the materials, and the limits of scene sizes
"""
