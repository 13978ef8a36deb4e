"""A day of shadows

The shadows of a summer's day, from half past seven in the morning to half past eight in the evening. Sun positions come
from pvlib: `pip install 'antumbra[sun]'`.
"""

from datetime import date
from zoneinfo import ZoneInfo

from PIL import Image

import antumbra as at

SIZE = 640, 400
SPP = 16
TRIANGLES = 200_000
scene = at.procedural("city", triangles=TRIANGLES)
camera = at.Camera((66, 62, 58), (2, 0, -4), vfov=32, width=SIZE[0], height=SIZE[1])
place = at.Place(52.0, 4.36, timezone="Europe/Amsterdam")
suns = at.suns_of(place, at.times_of([date(2026, 6, 21)], ZoneInfo(place.timezone), step=60), "y")
renderer, sheet = at.Renderer(scene), Image.new("RGB", (2 * SIZE[0], 2 * SIZE[1]))
for k, towards in enumerate(suns.directions[[2, 6, 13, 15]]):
    colour = (1.0, 0.65 + 0.35 * towards[1], 0.4 + 0.55 * towards[1])
    sun = at.DirectionalLight(-towards, angular_diameter=0.53, intensity=5, colour=colour)
    frame = renderer.render(camera, [sun, at.Sky(intensity=0.6)], spp=SPP, adaptive=SPP)
    frame.save("hour.png", exposure=1.3)
    sheet.paste(Image.open("hour.png"), (k % 2 * SIZE[0], k // 2 * SIZE[1]))
sheet.save("day.png")
