"""A film of a day

The shadows of a city on a day in September, a picture every twenty minutes. Sun positions come from pvlib: `pip
install 'antumbra[sun]'`.
"""

from datetime import date
from zoneinfo import ZoneInfo

from PIL import Image

import antumbra as at

SIZE = 720, 420
SPP = 16
TRIANGLES = 100_000
scene = at.procedural("city", triangles=TRIANGLES)
camera = at.Camera((58, 62, 74), (-2, 0, 0), vfov=33, width=SIZE[0], height=SIZE[1])
place = at.Place(52.0, 4.36, timezone="Europe/Amsterdam")
suns = at.suns_of(place, at.times_of([date(2026, 9, 12)], ZoneInfo(place.timezone), step=20), "y")
renderer, film = at.Renderer(scene), []
for towards in suns.directions:
    sun = at.DirectionalLight(-towards, angular_diameter=0.53, intensity=4 * min(1.0, 0.3 + 1.5 * towards[1]))
    frame = renderer.render(camera, [sun, at.Sky(intensity=0.6)], spp=SPP)
    frame.save("hour.png", exposure=1.0)
    film.append(Image.open("hour.png").convert("RGB"))
film = film[3:] + film[:3]  # begins with the long shadows of the morning
whole = {"save_all": True, "kmax": 1, "quality": 74, "method": 4}  # parts of frames would show edges
film[0].save("sun_film.webp", append_images=film[1:], duration=90, loop=0, **whole)
