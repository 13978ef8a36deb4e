"""Shadow queries of pictures and of points: surfaces become receivers, and lights become samples.

- raster: the surfaces that a camera sees, by rasterisation; gbuffer: the form in which a picture keeps them
- raster_cull, raster_setup, raster_bins, raster_tiles, raster_depth: the steps of the rasteriser
- pixels: the ray of a pixel, for rasteriser and tracers; rays: checked arrays of rays
- receivers: points of surfaces, moved off their surface; bounds: the extent of triangles and points
- sampling: sets of light samples; samples: the point of a sample, for a receiver, in kernels
- shadow: `ShadowQuery`; picture: the queries of a picture
- surface: whether two pixels see the same surface; refine: pixels that get more rays; subpixels: points inside a pixel
- diffuse: passes of diffuse rays; ground: the points of a level ground that rays meet
"""
