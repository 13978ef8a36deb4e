"""Procedural scenes of any size, without a file: atrium, city, forest, and scenes that other packages add.

This module imports nothing, so that `generated_scene` can be imported without the generators.

- `generated_scene`: procedural scenes as scene data, and the city as a stream
- `procedural_scenes`: the registry of scenes, and `generate`
- `atrium`: a courtyard with arcades
- `city`: streets, towers and houses; also as a stream of blocks
- `forest`: a path through trees
- `props`: plants, trees and furniture
- `shapes`: small closed meshes, and instanced copies of them
- `palette`: the materials, and the limits of scene sizes
"""
