"""Light from a panorama

The sky is an array: a sunset of 512 x 256 pixels. Its directions are drawn by importance, and each casts a shadow.
Files in .hdr and .exr work the same way: `at.Sky("studio.hdr")`.
"""

import numpy as np

import antumbra as at

SIZE = 1024, 640
SPP = 16
TRIANGLES = 500_000
height, turn = np.meshgrid(np.linspace(np.pi / 2, -np.pi / 2, 256), np.linspace(-np.pi, np.pi, 512), indexing="ij")
low = np.exp(-5 * np.abs(height))[..., None]
sun = np.exp(-400 * ((height - 0.22) ** 2 + (turn - 2.2) ** 2))[..., None]
sunset = 0.04 * np.array([0.25, 0.4, 0.9]) + 0.1 * low * (1.0, 0.5, 0.3) + 300 * sun * (1.0, 0.55, 0.25)
scene = at.procedural("city", triangles=TRIANGLES)
camera = at.Camera((95, 60, 95), (0, 3, 0), vfov=38, width=SIZE[0], height=SIZE[1])
sky = at.Sky(sunset, count=1024)
at.render(scene, camera, sky, spp=SPP, adaptive=SPP, filter=True).save("environment.png", exposure=8.0)
