"""A city in UTM coordinates

Delft as it lies in its map, 5,763 km north of the equator. On the left, coordinates are rounded to float32, as in many
programs: one step is half a metre. On the right, Antumbra recentres in float64 first. Moving a scene changes no bit.
"""

import numpy as np
from PIL import Image

import antumbra as at

SIZE = 640, 720
SPP = 16
utm = np.array([592_770.0, 5_763_170.0, 0.0])
model = at.load("delft_city.glb", up="z").triangles()
vertices = model.vertices.astype(float) + model.origin + utm
sheet = Image.new("RGB", (2 * SIZE[0], SIZE[1]))
for k, made in enumerate([vertices.astype(np.float32), vertices]):
    scene = at.Scene.from_arrays(made.reshape(-1, 3), np.arange(3 * len(made)).reshape(-1, 3), model.colour, up="z")
    camera = at.Camera(utm + (-60, -90, 40), utm + (5, -15, 4), (0, 0, 1), 35, *SIZE)
    at.render(scene, camera, spp=SPP, adaptive=SPP).save("half.png")
    sheet.paste(Image.open("half.png"), (k * SIZE[0], 0))
sheet.save("utm.png")
