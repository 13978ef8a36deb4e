"""From a scene, a camera and lights to a frame and its image files.

- `renderer`: `render` and `Renderer`
- `render_options`: `RenderOptions` and `EngineOptions`
- `option_fields`: signatures, docstrings and CLI options derived from the fields of options
- `frame`: `Frame`, and the state of a frame while it is rendered
- `frame_request`: checked arguments, memory estimate, and shadow queries of a frame
- `frame_passes`: the passes of a frame, from evaluation to smooth edges
- `row_bands`: a picture traced in bands of rows
- `shadow_catcher`: a ground plane that shows only shadows
- `virtual_point_lights`: instant radiosity
- `pixel_appearance`: base colours and shading normals of pixels
- `irradiance`: unshadowed irradiance in closed form
- `light_visibility`: visible fractions of lights from occlusion bits
- `shading`: diffuse shading and background
- `discontinuity_filter`: the filter of interleaved sampling
- `morphological_antialiasing`: smooth edges
- `image_files`: tone mapping, PNG, EXR and films
- `heat_maps`: false colours and labelled panels
- `plan_comparison`: seconds, counters and bits of several plans
- `traversal_steps`: traversal steps of shadow rays by plan
- `culling_picture`: what pre-BVH culling keeps
- `render_kernels`: compile jobs of rendering
"""
