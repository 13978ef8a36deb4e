"""Skylines: the elevation of the horizon that points see, by azimuth.

- `skyline`: `skyline` and its result
- `skyline_options`: options of `skyline`
- `edge_projection`: the kernel, which projects the edges of triangles
- `horizon_diagram`: the polar diagram of a report
"""
