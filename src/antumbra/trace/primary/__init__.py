"""The camera's rays through the BVH: blocks of pixels as frusta, then as packets.

- trace: `trace_primary`, threads and tiles; frusta: blocks against boxes
- pixelsetup, pixelblock: triangles set up once, tested against a block of pixels; pixelstate: what a block knows
- resolve: pixels that float32 could not decide
"""
