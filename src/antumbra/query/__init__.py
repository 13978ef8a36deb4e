"""Shadow queries of pictures and points: receivers on surfaces, and samples on lights.

- `query_bounds`: bounds of triangles and points, light placement, Morton order of points
- `receivers`: surface points offset from their surface
- `light_samples`: sample sets of a light, and sample points in kernels
- `shadow_query`: `ShadowQuery`, the queries of a picture, samples below the horizon
- `ray_list`: checked ray arrays; `point_list`: checked points
- `ray_passes`: one ray per pixel: diffuse rays, camera rays, hits on a ground plane
- `gbuffer`: G-buffer, pixel rays, smooth-surface test; `resident_gbuffer`: one on a device
- `raster_setup`: edge functions and depth keys of a triangle
- `raster_bins`: screen bounds of triangles, triangle list of each tile
- `rasteriser`: `rasterise`, tile by tile
- `surface_caps`: triangles that close open surfaces
- `cap_columns`: whether rays along axes and diagonals cross caps an odd number of times
- `occupancy_grid`: cells that no triangle touches, and their regions
- `pixel_refinement`: pixels at silhouettes and in penumbrae, and their sub-pixels
"""
