"""Triangles over time, with cameras and lights, from files, arrays or generators.

- scene: `Scene`; any_scene: its common base with the scenes of stores
- engine: the ray queries and the room behind a scene; hit: the answer to closest-hit rays
- source, mesh: the interface to a scene's geometry, and indexed triangles
- frames: folders of arrays, one for each moment
- crs: coordinate reference systems
- triangles, gather: one moment as float32 triangles; recentre, survey: the origin of their frame, and the bounds
- camera, framing: cameras, and the default camera and light of a scene without its own
- view, sampled, room: what a default picture shows, and the light in it; sky, environment: skies, and their files
- lights, point_lights: lights, and lists of point lights; colour: base colours
- gltf/, meshfile: readers of files; arrayfile: arrays from .npy and .npz files; files: checks of paths
- generated, procedural/: scenes without a file
"""
