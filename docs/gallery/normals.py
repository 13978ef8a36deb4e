"""Normals and visibility

Each frame carries its surfaces: here, normals as colours, times the fraction of a sun's disk that each pixel sees.
"""

import numpy as np
from PIL import Image

import antumbra as at

SIZE = 1024, 640
SPP = 16
TRIANGLES = 100_000
scene = at.procedural("atrium", triangles=TRIANGLES)
sun = at.DirectionalLight((-0.5, -0.9, -0.4), angular_diameter=2)
frame = at.render(scene, scene.cameras[0].resized(*SIZE), sun, spp=SPP)
shade = 0.35 + 0.65 * frame.visibility[0][..., None]
picture = np.where(frame.mask[..., None], (0.5 + 0.5 * frame.gbuffer.normal) * shade, 0.95)
Image.fromarray(np.uint8(np.rint(255 * picture))).save("normals.png")
