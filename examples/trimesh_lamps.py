"""Which vertices of a trimesh see which lamps, as a coloured PLY: python examples/trimesh_lamps.py [FOLDER]

The mesh is the Stanford bunny if it is in the folder $ANTUMBRA_SCENES, else a torus knot of spheres.
"""

import os
import sys
import tempfile
from pathlib import Path

import numpy as np
import trimesh

import antumbra as at

bunny = Path(os.environ.get("ANTUMBRA_SCENES", "nowhere")) / "stanford_bunny" / "scene.glb"
if bunny.exists():
    mesh = trimesh.load(bunny, force="mesh")
else:
    turns = np.linspace(0.0, 2.0 * np.pi, 60, endpoint=False)
    around = 2.0 + np.cos(3.0 * turns)
    centres = np.stack([around * np.cos(2.0 * turns), np.sin(3.0 * turns), around * np.sin(2.0 * turns)], axis=-1)
    ball = trimesh.creation.icosphere(2, 0.35)
    mesh = trimesh.util.concatenate([ball.copy().apply_translation(centre) for centre in centres])

scene = at.load(mesh, up="y")  # directly, without a file
centre, size = scene.bounds.mean(0), np.ptp(scene.bounds, axis=0).max()
towards = np.array([[1.0, 0.5, 0.5], [-1.0, 0.5, 0.5], [0.0, 1.0, -1.0]])  # a red, a green and a blue lamp
lamps = [at.SphereLight(centre + size * d, 0.1 * size, colour=c) for d, c in zip(towards, np.eye(3))]

visibility = at.visibility(scene, mesh.vertices, lamps, mesh.vertex_normals, spp=16)
print(visibility)
print("vertices that see no lamp:", int((~visibility.seen.any(axis=-1)).sum()), "of", len(mesh.vertices))

folder = Path(sys.argv[1] if len(sys.argv) > 1 else tempfile.mkdtemp())
colours = np.rint(255.0 * (0.1 + 0.9 * visibility.fraction)).astype(np.uint8)
coloured = trimesh.Trimesh(mesh.vertices, mesh.faces, vertex_colors=colours, process=False)
coloured.export(folder / "lamps.ply")

# The picture, and an EXR with separate layers per lamp: shadow.*, light.*, albedo, ids.
frame = at.render(scene, lights=[lamp.named(name) for lamp, name in zip(lamps, ("red", "green", "blue"))], layers=True)
frame.save(folder / "lamps.png")
frame.save(folder / "lamps.exr")
print(f"written: {folder / 'lamps.ply'}, lamps.png and lamps.exr")
