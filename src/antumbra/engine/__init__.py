"""The one door to all questions about a scene, and what is cached between them.

- `engine`: `Engine`
- `ray_queries`: the ray queries that engines and scenes share
- `visibility`: `Visibility`, which points see which samples of lights
- `scene`: `AnyScene`, `Scene`, `procedural`
- `paged_scene`: `PagedScene`
- `scene_loading`: `load`
- `gis_scenes`: `from_raster`, `from_footprints`
- `tree_scenes`: `from_trees`
- `scene_reading`: the data of a file, folder or mesh
- `store_building`: `build_store`
- `point_visibility`: `visibility`
- `tree_choice`: what is built for some queries, and what outlives it
- `accelerator`: trees by plan, cached trees
- `auto_accelerator`: the choice of trees by `auto`
- `frame_tracer`: `RenderSource`, `FrameTracer`, memory estimates
- `in_memory_source`: scenes in memory, and their ray lists
- `refitted_rays`: the tree of ray lists while users move the geometry
- `instanced_source`: scenes of instances
- `paged_source`: scenes in stores: bands, ray lists, trees
- `paged_hits`: all hits of ray lists in stores
- `terrain_shadows`: queries at points over rasters of heights, without a tree
- `primary_visibility`: the surfaces that a camera sees
- `default_view`: what default pictures show
- `precompilation`: compiles recorded kernels before anything is timed
- `plan`: `Plan`, the methods that answer a query
- `method_registry`: cullers, builders, optimisers, updaters and tracers by name
- `auto/`: the choice of a strategy for each query
"""
