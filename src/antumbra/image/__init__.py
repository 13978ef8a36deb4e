"""From bits to pictures: the share of a light that is seen, filtered, shaded, mapped to colours and saved.

- fraction, filter: shares of lights, smoothed over pixels of the same surface
- irradiance, point_lights, shade: what arrives at a surface, and the image
- tonemap, heatmap, save: PNG and EXR files
"""
