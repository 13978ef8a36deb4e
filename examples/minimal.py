"""A picture with soft shadows: python examples/minimal.py [FOLDER] [SCENE]"""

import sys
import tempfile
from pathlib import Path

import antumbra as at

folder = Path(sys.argv[1] if len(sys.argv) > 1 else tempfile.mkdtemp())
scene = at.load(sys.argv[2]) if len(sys.argv) > 2 else at.procedural("atrium", triangles=20_000)

camera = scene.cameras[0] if scene.cameras else scene.default_camera()
lights = scene.lights or [scene.default_light()]

frame = at.render(scene, camera.resized(320, 240), lights, spp=16)
frame.save(folder / "minimal.png")
frame.save(folder / "minimal.exr")

seconds = ", ".join(f"{phase} {1000 * t:.0f} ms" for phase, t in frame.timings.items() if t)
print(f"{scene.name}: {scene.n_triangles} triangles, {frame.rays} shadow rays; {seconds}")
print(f"written: {folder / 'minimal.png'}")
