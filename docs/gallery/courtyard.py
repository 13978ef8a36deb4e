"""San Miguel

Two million triangles: a courtyard in a low, warm sun, with the light that its walls return.
"""

import antumbra as at

SIZE = 1280, 800
SPP = 16
BOUNCE = 12
scene = at.load("sanmiguel_lite.glb", up="z")
camera = at.Camera((6.37, -5.63, 1.64), (7.1, -4.94, 1.76), (0, 0, 1), 64, *SIZE)
sun = at.DirectionalLight((0.15, 0.6, -0.8), angular_diameter=0.53, intensity=8, colour=(1.0, 0.74, 0.48))
sky = at.Sky((0.75, 0.85, 1.0), intensity=0.9)
light = {"bounce": BOUNCE, "bounces": 2, "bounce_step": 2}
at.render(scene, camera, [sun, sky], spp=SPP, adaptive=2 * SPP, filter=True, **light).save("courtyard.png")
