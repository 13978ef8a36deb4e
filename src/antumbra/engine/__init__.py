"""The one door to all questions about a scene, and what is remembered between them.

- engine: `Engine`; any_scene, scene, paged_scene: the faces that users have; loading, building: files and stores
- trees, accelerate, choosing: triangles at a moment and trees by plan; solid, srdh_rays: what goes into them
- source: the protocol by which an engine reads a scene; in_memory, paged: its two forms; memory, bands: what they take
- ray_lists, paged_rays, paged_tree: lists of rays; visibility: lights from points
- see, looking: the surfaces that a camera sees; views, room, wrapping: what default pictures show
- ready, precompile: kernels, which are compiled before anything is timed
"""
