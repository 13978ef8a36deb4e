"""The viewer in the browser, then a picture of its final state: python examples/view.py [FOLDER]

Requires viser: pip install 'antumbra[view]'. With FOLDER, it does not wait for a user.
"""

import sys
import tempfile
from pathlib import Path

import antumbra as at

folder = Path(sys.argv[1] if len(sys.argv) > 1 else tempfile.mkdtemp())
scene = at.examples.temple()

waits = len(sys.argv) == 1
with at.view(scene, port=0, browser=waits) as viewer:
    print(f"{scene.name} is at {viewer.url}")
    if waits:
        try:
            viewer.wait()  # until Ctrl-C
        except KeyboardInterrupt:
            print("closed")

frame = at.render(scene, viewer.camera.resized(640, 400), viewer.lights, time=viewer.time)
frame.save(folder / "view.png")
print(f"the sun reaches {frame.visibility[0][frame.mask].mean():.0%} of the surfaces: {folder / 'view.png'}")
