"""A ball with and without a texture and smooth normals: python examples/textures.py FOLDER

All three pictures have the same shadows, because textures and normals change only the shading.
"""

import sys
from pathlib import Path

import numpy as np
from PIL import Image

import antumbra as at

folder = Path(sys.argv[1] if len(sys.argv) > 1 else ".")

# A coarse ball at (0, 1, 0); u runs around it, and v from the upper to the lower pole.
n = 10
v, u = np.meshgrid(np.linspace(0, 1, n + 1), np.linspace(0, 1, 2 * n + 1), indexing="ij")
theta, phi = np.pi * v.ravel(), 2 * np.pi * u.ravel()
normals = np.stack([np.sin(theta) * np.cos(phi), np.cos(theta), -np.sin(theta) * np.sin(phi)], 1)
corner = (np.arange(n)[:, None] * (2 * n + 1) + np.arange(2 * n)).ravel()
below = corner + 2 * n + 1
faces = np.concatenate([np.stack([corner, below, corner + 1], 1), np.stack([corner + 1, below, below + 1], 1)])
uv = np.stack([u.ravel(), v.ravel()], 1)

# A floor, mapped to a plain part of the texture.
floor = np.array([[-4, 0, -4], [-4, 0, 4], [4, 0, 4], [4, 0, -4]], float)
points = np.concatenate([normals + (0, 1, 0), floor])
faces = np.concatenate([faces, len(normals) + np.array([[0, 1, 2], [0, 2, 3]])])
normals = np.concatenate([normals, np.tile([0.0, 1.0, 0.0], (4, 1))])
uv = np.concatenate([uv, np.full((4, 2), 0.01)])

texture = np.full((256, 512, 3), 235, np.uint8)
rows, columns = np.indices((256, 512)) // 32
texture[(rows + columns) % 2 == 1] = (40, 110, 160)
texture[:32] = 235

scene = at.Scene.from_arrays(points, faces, uv=uv, texture=texture, normals=normals, name="ball")
camera = at.Camera((0.4, 1.9, 4.2), (0, 0.95, 0), vfov=38, width=320, height=320)
lights = [at.DirectionalLight(direction=(1.0, -0.55, -0.35), intensity=3.0), at.Sky(intensity=0.4)]
renderer = at.Renderer(scene)

pictures, frames = [], []
for options in ({"textures": False, "smooth_normals": False}, {"textures": False}, {}):
    frames.append(renderer.render(camera, lights, adaptive=64, **options))
    frames[-1].save(folder / "ball.png", exposure=0.3)
    pictures.append(np.asarray(Image.open(folder / "ball.png")))
Image.fromarray(np.concatenate(pictures, axis=1)).save(folder / "shading.png", optimize=True)

same = all(np.array_equal(a, b) for frame in frames[1:] for a, b in zip(frame.bits, frames[0].bits))
print(f"{scene.n_triangles} triangles; the bits of all pictures are {'the same' if same else 'DIFFERENT'}")
