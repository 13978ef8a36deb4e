"""Triangles over time, with cameras and lights, from files, arrays or generators.

- scene: `Scene`; source, mesh, frames: sources of its pieces; engine: the ray queries behind `Scene`
- triangles, gather, recentre, survey: one moment as float32 triangles around the scene's origin
- camera, framing, lights, point_lights, colour: cameras, lights and base colours
- gltf/, meshfile, files: readers; generated, procedural/: scenes without a file
"""
