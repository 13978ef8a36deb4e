"""Baked light

A temple before and after `antumbra bake`: colours without any light, and the same with the sun and the sky that its
vertices receive. A viewer shows the file on the right as it is, without lights of its own.
"""

import numpy as np
from PIL import Image

import antumbra as at
from antumbra.picture.image_files import to_srgb8

SIZE = 640, 800
SPP = 16
temple = at.examples.file_of("temple")
sun = at.load(temple).default_lights()[0]
lights = [sun, at.AmbientOcclusion(np.inf, intensity=2)]
at.bake(temple, "baked.glb", what="light", lights=lights, spp=SPP)
halves = []
for file in (temple, "baked.glb"):
    scene = at.load(file)
    frame = at.render(scene, scene.default_camera(*SIZE), layers=True)
    halves.append(np.where(frame.mask[..., None], to_srgb8(frame.layers.albedo, 1.0), 245))
Image.fromarray(np.hstack(halves).astype(np.uint8)).save("bake.png")
