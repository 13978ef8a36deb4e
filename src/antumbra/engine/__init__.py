"""The one door to all questions about a scene, and what is cached between them.

- `engine`: `Engine`
- `ray_queries`: the ray queries that engines and scenes share
- `visibility`: `Visibility`, which points see which samples of lights
- `scene`: `AnyScene`, `Scene`, `procedural`
- `paged_scene`: `PagedScene`
- `scene_loading`: `load`
- `vegetation_scenes`: `from_trees`
- `scene_reading`: the data of a file, folder or mesh
- `measured_scenes`: scenes whose heights and distances in plan are lengths in one unit
- `store_building`: `build_store`
- `point_visibility`: `visibility`
- `tree_choice`: what is built for some queries, and what outlives it
- `accelerator`: trees by plan, cached trees
- `auto_accelerator`: the choice of trees by `auto`
- `frame_tracer`: `RenderSource`, `FrameTracer`, memory estimates
- `refitted_rays`: the tree of ray lists while users move the geometry
- `primary_visibility`: the surfaces that a camera sees
- `default_view`: what default pictures show
- `precompilation`: compiles recorded kernels before anything is timed
- `plan`: `Plan`, the methods that answer a query
- `method_registry`: cullers, builders, optimisers, updaters and tracers by name
- `sources/`: where the triangles are
- `auto/`: the choice of a strategy for each query
"""
