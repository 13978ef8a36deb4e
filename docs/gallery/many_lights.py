"""Many lights

A city at night under 600 lamps, warm in the streets and coloured in the park. They are one light, `PointLights`, and
each lamp has exact shadows.
"""

import numpy as np

import antumbra as at

SIZE = 1024, 640
COUNT = 600
TRIANGLES = 200_000
scene = at.procedural("city", triangles=TRIANGLES)
rng = np.random.default_rng(4)
above = np.stack([rng.uniform(-100, 100, 4000), np.full(4000, 100.0), rng.uniform(-100, 100, 4000)], 1)
ground = scene.closest_hit(above, (0, -1, 0)).t > 99.4  # not on a roof, a car or a tree
lamps = (above[ground] - (0, 96, 0))[:COUNT]
park = np.abs(lamps[:, [0, 2]]).max(1) < 20
colours = np.where(park[:, None], rng.dirichlet((0.4, 0.4, 0.4), len(lamps)), (1.0, 0.6, 0.25))
bulbs = at.PointLights(lamps, colours=colours, nearest=1.0, interleave=True)
night = {"ambient": False, "background": False}
camera = at.Camera((95, 60, 95), (0, 0, 0), vfov=34, width=SIZE[0], height=SIZE[1])
frame = at.render(scene, camera, [bulbs, at.Sky((0.3, 0.4, 1.0), intensity=0.004)], filter=True, **night)
frame.save("many_lights.png", background=(0.03, 0.04, 0.1))
