"""Many lights

An atrium under 600 bulbs, whose colours change across the court. They are one light, `PointLights`, and each bulb has
exact shadows.
"""

import colorsys

import numpy as np

import antumbra as at

SIZE = 1024, 640
COUNT = 600
TRIANGLES = 200_000
scene = at.procedural("atrium", triangles=TRIANGLES)
rng = np.random.default_rng(4)
(x0, _, z0), (x1, _, z1) = scene.bounds
places = np.stack([rng.uniform(0.8 * x0, 0.8 * x1, COUNT), rng.uniform(1, 6, COUNT), rng.uniform(z0, z1, COUNT)], 1)
colours = [colorsys.hsv_to_rgb(hue, 0.85, 1.0) for hue in (places[:, 0] - x0) / (x1 - x0)]
bulbs = at.PointLights(places, colours=colours, nearest=0.3, interleave=True)
at.render(scene, scene.cameras[0].resized(*SIZE), bulbs, filter=True).save("many_lights.png")
