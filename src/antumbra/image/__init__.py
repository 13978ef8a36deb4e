"""Makes pictures from occlusion bits: fractions of lights, filtering, shading, tone mapping and files.

- fraction, filter: the fraction of a light that each pixel sees, and its filter
- irradiance, point_lights, shade: irradiance of surfaces, and the image
- background: what pixels without a surface show
- tonemap, save: colours, and PNG and EXR files; heatmap, panels: numbers as colours, side by side
"""
