"""Shadow queries of pictures and points: surfaces become receivers, and lights become samples.

- `query_bounds`: boxes around triangles and points, lights placed in the scene's frame, Morton order of points
- `receivers`: surface points moved off their surface
- `light_samples`: sample sets on a light, and the point of each sample in kernels
- `shadow_query`: `ShadowQuery`, the queries of a picture, samples below the horizon
- `ray_list`: checked arrays of rays
- `ray_passes`: one ray per pixel: diffuse rays, camera rays, hits on a level ground
- `gbuffer`: the surface of each pixel, the ray of a pixel, the test for one smooth surface
- `raster_setup`: edge functions and depth of a triangle
- `raster_bins`: pixel bounds of triangles, and the triangle list of each tile
- `rasteriser`: `rasterise`, tile by tile
- `pixel_refinement`: pixels at silhouettes and in penumbrae, and their sub-pixels
"""
