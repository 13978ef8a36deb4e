"""Ambient occlusion

The fraction of the sky that each point sees, weighted by the cosine: visibility alone, without lights or materials.
"""

import numpy as np
from PIL import Image

import antumbra as at

SIZE = 1280, 800
SPP = 64
TRIANGLES = 500_000
scene = at.procedural("city", triangles=TRIANGLES)
camera = at.Camera((95, 60, 95), (0, 0, 0), vfov=38, width=SIZE[0], height=SIZE[1])
frame = at.render(scene, camera, at.AmbientOcclusion(np.inf), spp=SPP, filter=True)
picture = np.where(frame.mask, frame.visibility[0] ** 0.7, 0.93)
Image.fromarray(np.uint8(np.rint(255 * picture))).convert("RGB").save("ambient_occlusion.png")
