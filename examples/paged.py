"""A walk through a city in a store, mostly out of memory: python examples/paged.py [FOLDER]

For a city larger than memory: antumbra build "procedural:city?triangles=350M" -o city.antumbra
"""

import sys
import tempfile
from pathlib import Path

import antumbra as at

folder = Path(sys.argv[1] if len(sys.argv) > 1 else tempfile.mkdtemp())
path = folder / "city.antumbra"
built = at.build_store([at.procedural("city", triangles=300_000)], path, chunk=4096)
print(f"{built.triangles:,} triangles in {built.chunks} chunks, {built.bytes / 1e6:.0f} MB")

scene = at.load(path)
renderer = at.Renderer(scene, max_memory=2 << 30)  # keeps the visible set from frame to frame
for k in range(5):
    camera = at.Camera((7, 1.7, 30 - 2 * k), (7, 3, -60), width=640, height=360)
    frame = renderer.render(camera, scene.lights, spp=16)
    shadows, paging = frame.scheduled[-1], frame.paging
    print(
        f"frame {k}: {frame.timings['total'] * 1e3:.0f} ms, {shadows['queries']} queries about shadows, "
        f"{paging['loaded']} chunks read"
    )
frame.save(folder / "street.png")
print(f"written: {folder / 'street.png'}")
