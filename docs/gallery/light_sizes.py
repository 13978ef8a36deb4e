"""From a point to a large lamp

The same light with a radius of a thousandth, 3, 10 and 30 % of the size of a mill.
"""

import numpy as np
from PIL import Image

import antumbra as at

SIZE = 640, 480
SPP = 64
scene = at.examples.mill()
middle, size = scene.bounds.mean(0), np.ptp(scene.bounds, axis=0).max()
centre = middle + size * np.array([1.1, 1.0, 0.6])
camera = at.Camera(middle + size * np.array([-0.9, 0.8, 1.5]), middle - size * np.array([0.4, 0.24, 0.15]), vfov=40)
sheet = Image.new("RGB", (2 * SIZE[0], 2 * SIZE[1]))
for k, radius in enumerate([0.001, 0.03, 0.1, 0.3]):
    lamp = at.SphereLight(centre, radius * size, intensity=4 * size**2)
    lights = [lamp, at.Sky(intensity=0.15)]
    frame = at.render(scene, camera.resized(*SIZE), lights, spp=SPP, filter=True, adaptive=SPP, ground=True)
    frame.save("panel.png")
    sheet.paste(Image.open("panel.png"), (k % 2 * SIZE[0], k // 2 * SIZE[1]))
sheet.save("light_sizes.png")
