"""Scenes, and the engines that answer all queries about them and cache trees in between.

- `engine`: `Engine`, `Visibility`, the kernels of a plan
- `scene`: `AnyScene`, `Scene`, `procedural`
- `paged_scene`: `PagedScene`
- `scene_loading`: `load`
- `scene_reading`: read the data of a scene from a file, folder or mesh
- `store_building`: `build_store`
- `point_visibility`: `visibility`
- `accelerator`: build trees by a plan, choose the builder of `auto`, cache trees
- `frame_tracer`: `RenderSource`, `FrameTracer`, memory estimates
- `in_memory_source`: scenes in memory and their ray lists
- `paged_source`: scenes in stores: bands, ray lists, trees
- `primary_visibility`: the surfaces visible to a camera
- `default_view`: the geometry of default views
- `precompilation`: jobs that compile kernels before anything is timed
"""
