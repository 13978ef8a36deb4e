"""Hard shadows

A sun without a diameter, low over a city of half a million triangles. Every edge of a shadow is exact.
"""

import antumbra as at

SIZE = 1280, 800
SPP = 16
TRIANGLES = 500_000
scene = at.procedural("city", triangles=TRIANGLES)
camera = at.Camera((95, 60, 95), (0, 0, 0), vfov=38, width=SIZE[0], height=SIZE[1])
sun = at.DirectionalLight((-0.9, -0.75, 0.35), 0.0, intensity=4, colour=(1.0, 0.85, 0.65))
at.render(scene, camera, [sun, at.Sky()], spp=SPP, adaptive=SPP).save("hard_shadows.png")
