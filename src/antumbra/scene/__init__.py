"""Triangles over time, with cameras and lights, from files, arrays or generators.

- scene, source, mesh, frames: `Scene`, and what it gets its pieces from; engine: what answers its rays
- triangles, gather, recentre, survey: one moment as float32 triangles around the scene's origin
- camera, framing, lights, point_lights, colour: what looks and what shines
- gltf/, meshfile, files: readers; generated, procedural/: scenes without a file
"""
