"""From a scene, a camera and lights to a frame, and from points to what they see.

- renderer, frame: `render` and `Renderer`; queries: `visibility`, `Scene.occluded`
- passes, state: one frame, pass by pass; indirect, virtual_lights: light that bounces
- source: what a frame needs of a scene; in_memory and paged supply it, of triangles in memory and of a store
- accelerate, srdh_rays: what a plan's tracer takes; the rays that builders are shown
- building: `build_store`; explanation, culling_picture: pictures of what a plan does
- ready: kernels are compiled before anything is timed; render_jobs: those of frames; warm: all there are
"""
