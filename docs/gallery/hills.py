"""Terrain

A kilometre of mountains, a height field of two million triangles, in the morning: ridges shade the valleys.
"""

import numpy as np

import antumbra as at

SIZE = 1280, 800
SPP = 16
TRIANGLES = 2_000_000
n, rng = int((TRIANGLES / 2) ** 0.5) + 1, np.random.default_rng(5)
waves = np.hypot(*np.meshgrid(np.fft.fftfreq(n), np.fft.fftfreq(n)))
waves[0, 0] = np.inf
noise = [np.fft.ifft2(np.fft.fft2(rng.normal(size=(n, n))) * waves**-p).real for p in (2.1, 2.4)]
ridges, rises = (each / each.std() for each in noise)
heights = 190 - np.minimum(110 * np.sqrt(ridges**2 + 0.002) * np.clip(0.7 + 0.5 * rises, 0.15, 1.6), 190) + 25 * rises
east, north = np.meshgrid(np.linspace(0, 1024, n), np.linspace(0, 1024, n))
points = np.stack([east, north, heights], -1).reshape(-1, 3)
first = np.arange(n * n).reshape(n, n)[:-1, :-1].reshape(-1, 1)
faces = np.concatenate([first + (0, 1, n), first + (1, n + 1, n)])
corners = points[faces]
normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
level, top = (normals[:, 2] / np.linalg.norm(normals, axis=1))[:, None], corners[:, :, 2].mean(1)[:, None]
rock, meadow, snow = np.array([[0.3, 0.25, 0.22], [0.16, 0.24, 0.07], [0.85, 0.87, 0.9]])
colours = rock + np.clip(6 * level - 4.2, 0, 1) * (meadow - rock)
colours += np.clip(top / 20 - 8.75, 0, 1) * np.clip(5 * level - 2.2, 0, 1) * (snow - colours)
scene = at.Scene.from_arrays(points, faces, up="z", colours=colours)
camera = at.Camera((-60, 512, 330), (500, 512, 70), (0, 0, 1), 40, *SIZE)
sun = at.DirectionalLight((0.85, 0.3, -0.36), angular_diameter=0.53, intensity=6, colour=(1.0, 0.72, 0.45))
sky = at.Sky((0.35, 0.55, 1.0), intensity=0.35)
at.render(scene, camera, [sun, sky], spp=SPP, adaptive=SPP, filter=True).save("hills.png")
