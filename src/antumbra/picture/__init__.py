"""Render a scene, seen by a camera and lit by lights, to a frame and its image files.

- `renderer`: `render` and `Renderer`
- `render_options`: `RenderOptions` and `EngineOptions`
- `frame`: `Frame`, and the state shared by the passes of a frame
- `frame_request`: checked arguments, memory estimate and shadow queries of a frame
- `frame_passes`: the passes of a frame, from evaluation to smooth edges
- `bounced_light`: paths of diffuse rays
- `row_bands`: pictures traced in bands of rows
- `shadow_catcher`: an invisible ground plane that shows the shadows cast on it
- `virtual_point_lights`: instant radiosity
- `seen_appearance`: the appearance of the triangles that a picture sees, also of stores
- `pixel_appearance`: base colours and shading normals of pixels
- `pixel_materials`: maps of glTF materials in pixels
- `ggx`: the GGX lobe of glTF
- `material_shading`: lobes, mirrored skies and emitted light
- `irradiance`: unshadowed irradiance in closed form
- `light_visibility`: visible fractions of lights from occlusion bits
- `shading`: diffuse shading and background
- `discontinuity_filter`: the discontinuity filter of interleaved sampling
- `morphological_antialiasing`: anti-aliasing without extra rays
- `picture_records`: the settings of a picture as JSON
- `image_files`: tone mapping, PNG, EXR and films
- `heat_maps`: false colours and labelled panels
- `traversal_steps`: traversal steps of shadow rays, plan by plan
- `example_calls`: calls on small scenes whose kernels are recorded
"""
