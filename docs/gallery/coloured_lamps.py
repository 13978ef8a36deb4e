"""Three lamps

A red, a green and a blue lamp. Where one is hidden, the other two remain: shadows are cyan, magenta and yellow.
"""

import numpy as np

import antumbra as at

SIZE = 1024, 640
SPP = 64
scene = at.examples.mill()
centre, size = scene.bounds.mean(0), np.ptp(scene.bounds, axis=0).max()
towards = np.array([[0.9, 0.8, 0.5], [0.1, 1.0, 0.9], [-0.8, 0.8, 0.6]])
lamps = [
    at.SphereLight(centre + 1.2 * size * d, 0.06 * size, intensity=size**2, colour=c)
    for d, c in zip(towards, np.eye(3))
]
at.render(scene, scene.default_camera(*SIZE), lamps, spp=SPP, adaptive=SPP, ground=True).save("coloured_lamps.png")
