"""What a picture or a set of points asks: surfaces, receivers and light samples become shadow queries.

- raster*, gbuffer, surface, subpixels: what a camera sees, by rasterisation; pixels of one surface
- receivers, bounds: points that ask, moved off their surface; the distances in a scene
- sampling, samples: sets of light samples, and where a sample lies for a receiver
- shadow, picture: `ShadowQuery`, of points and of pixels; rays: arrays of rays
- refine, diffuse: samples of refined pixels; passes of diffuse rays
"""
