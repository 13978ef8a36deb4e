"""Bounced light

A bedroom behind blinds. On the left, ambient light is a constant; on the right, 64 diffuse rays per pixel gather the
light that floor and walls return.
"""

from PIL import Image

import antumbra as at

SIZE = 640, 720
SPP = 64
BOUNCE = 64
scene = at.procedural("blinds")
camera = scene.cameras[0].resized(*SIZE)
sheet = Image.new("RGB", (2 * SIZE[0], SIZE[1]))
for k, bounce in enumerate([None, BOUNCE]):
    at.render(scene, camera, scene.lights, spp=SPP, bounce=bounce, filter=True).save("half.png")
    sheet.paste(Image.open("half.png"), (k * SIZE[0], 0))
sheet.save("bounce.png")
