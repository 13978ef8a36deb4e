"""A street in UTM coordinates

A city in map coordinates, 5,763 km north of the equator. On the left, coordinates are rounded to float32, as in many
programs: one step is half a metre. On the right, Antumbra recentres in float64 first, so moving the city changes no
bit.
"""

import numpy as np
from PIL import Image

import antumbra as at

SIZE = 640, 720
SPP = 16
TRIANGLES = 100_000
utm = np.array([592_770.0, 0.0, -5_763_170.0])
model = at.procedural("city", triangles=TRIANGLES).triangles()
vertices = model.vertices.astype(float) + model.origin + utm
faces = np.arange(3 * len(vertices)).reshape(-1, 3)
sheet = Image.new("RGB", (2 * SIZE[0], SIZE[1]))
for k, made in enumerate([vertices.astype(np.float32), vertices]):
    scene = at.Scene.from_arrays(made.reshape(-1, 3), faces, colours=model.colour)
    camera = at.Camera(utm + (6, 4, 24), utm + (11, 2.5, 17), (0, 1, 0), 50, *SIZE)
    sun = at.DirectionalLight((0.8, -0.9, -0.5), intensity=4)
    at.render(scene, camera, [sun, at.Sky()], spp=SPP, adaptive=SPP).save("half.png")
    sheet.paste(Image.open("half.png"), (k * SIZE[0], 0))
sheet.save("utm.png")
