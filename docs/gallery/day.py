"""A day of shadows

The shadows of a summer's day, from seven in the morning to nine in the evening. Sun positions come from pvlib: `pip
install 'antumbra[sun]'`.
"""

from datetime import date
from zoneinfo import ZoneInfo

from PIL import Image

import antumbra as at

SIZE = 320, 320
SPP = 16
TRIANGLES = 200_000
scene = at.procedural("city", triangles=TRIANGLES)
camera = at.Camera((60, 85, 60), (0, 0, 0), vfov=36, width=SIZE[0], height=SIZE[1])
place = at.Place(52.0, 4.36, timezone="Europe/Amsterdam")
suns = at.suns_of(place, at.times_of([date(2026, 6, 21)], ZoneInfo(place.timezone), step=60), "y")
sheet = Image.new("RGB", (4 * SIZE[0], 2 * SIZE[1]))
for k, towards in enumerate(suns.directions[1:-1:2][:8]):
    sun = at.DirectionalLight(-towards, angular_diameter=0.53, intensity=4)
    at.render(scene, camera, [sun, at.Sky()], spp=SPP, adaptive=SPP).save("hour.png")
    sheet.paste(Image.open("hour.png"), (k % 4 * SIZE[0], k // 4 * SIZE[1]))
sheet.save("day.png")
