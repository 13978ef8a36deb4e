"""Makes pictures from occlusion bits: fractions of lights, filtering, shading, tone mapping and files.

- fraction, filter: how much of a light each pixel sees, and its filter
- emitters, irradiance, shares, list_irradiance: unshadowed irradiance, and the share of it that arrives
- terminator, shade: where the light of smooth normals ends, and the image
- background: what pixels without a surface show
- tonemap, save: colours, and PNG and EXR files; heatmap, panels: numbers as colours, side by side
"""
