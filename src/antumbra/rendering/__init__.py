"""From a scene, a camera and lights to a frame.

- renderer, frame: `render` and `Renderer`
- options: the options of a picture; keywords: what is derived from them
- request, passes, state: one frame, pass by pass; indirect, virtual_lights: light that bounces
- rows: a picture traced in bands of rows, in several processes
- ground: a ground below the scene, of which only the shadows are seen
- memory: what a frame takes
- explanation, comparison, culling_picture: pictures of the work of plans; moments, windows: their queries
- render_jobs: kernels of frames; warm: the list of all kernels that can be compiled ahead of time
"""
