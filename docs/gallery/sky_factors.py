"""View factors to the sky

The fraction of the radiation leaving each triangle of a village that reaches the sky.
"""

from matplotlib import colormaps

import antumbra as at

SIZE = 1280, 800
SPP = 64
village = at.examples.village()
factors = at.view_factors(village, "face", samples=1024)
colours = colormaps["magma"](factors.sky)[:, :3] ** 2.2  # linear
painted = at.Scene.from_arrays(village.triangles().vertices.reshape(-1, 3, 3) + village.origin, up="z", colours=colours)
frame = at.render(painted, painted.default_camera(*SIZE), at.Sky((1.0, 1.0, 1.0)), spp=SPP, filter=True)
frame.save("sky_factors.png")
