"""Camera rays through the BVH: tiles of pixels as frusta, then as cells of 4 x 4 pixels.

- `primary_rays`: `trace_primary`, and the frusta of a tile against boxes
- `pixel_tests`: triangles set up once per tile and tested against its pixels
- `pixel_hits`: the nearest hit of each pixel, its face and float64 `t`
"""
