"""The camera's rays through the BVH: tiles of pixels as frusta, then as cells of 4 x 4 pixels.

- trace: `trace_primary`, threads and tiles; frusta: the frusta of a tile against boxes
- pixelsetup, pixelblock: triangles set up once for a tile, and tested against its pixels
- pixelstate: the triangles that a tile's pixels have seen so far
- resolve: the faces and the float64 t of the pixels
"""
