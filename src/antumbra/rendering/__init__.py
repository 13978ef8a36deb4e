"""From a scene, a camera and lights to a frame, and from points to what they see.

- renderer, job, frame: `render` and `Renderer`; queries: `visibility`, `Scene.occluded`
- accelerate, srdh_rays: what a plan's tracer takes; the rays that builders are shown
- paged: scenes in a store; building: `build_store`
- indirect, virtual_lights: light that bounces
- explanation, culling_picture: pictures of what a plan does
- warm: kernels are compiled before anything is timed
"""
