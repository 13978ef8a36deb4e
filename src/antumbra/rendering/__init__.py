"""From a scene, a camera and lights to a frame, and from points to what they see.

- renderer, frame: `render` and `Renderer`; queries: `visibility`, `Scene.occluded`
- options: the options of a picture; keywords: what is derived from them
- request, passes, state: one frame, pass by pass; indirect, virtual_lights: light that bounces
- rows: a picture traced in bands of rows, in several processes
- ground: a ground below the scene, of which only the shadows are seen
- source: the protocol by which a frame reads a scene; in_memory: triangles in memory; paged: a scene in a store
- memory: what a frame takes; paged_rays, paged_tree: ray lists through a store, and its tree
- accelerate: builds and prepares the structure that a plan's tracer takes; srdh_rays: the rays shown to builders
- choosing: the trees of the plan `auto`; ray_trees: those of ray lists; looking: rasterisation or camera rays
- building: `build_store`; explanation, comparison, culling_picture: pictures of the work of plans
- room: whether a scene encloses a room, and a camera inside it; wrapping: what a closed box encloses
- moments, windows: their queries, and tests in parts of a picture
- ready: compiles kernels before anything is timed; render_jobs: the jobs of frames; warm: the list of all jobs
"""
