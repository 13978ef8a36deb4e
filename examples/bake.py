"""Bakes ambient occlusion and the light of a sun into glTF files: python examples/bake.py [FOLDER]

With the real scenes (ANTUMBRA_SCENES names their folder) it bakes a temple, else the embedded atrium. The texture needs
an atlas: pip install 'antumbra[bake]'
"""

import os
import sys
import tempfile
from pathlib import Path

import antumbra as at

folder = Path(sys.argv[1] if len(sys.argv) > 1 else tempfile.mkdtemp())
temple = Path(os.environ.get("ANTUMBRA_SCENES", "")) / "japanese_temple" / "scene.glb"
scene = temple if temple.is_file() else at.procedural("atrium", triangles=5_000)

# Ambient occlusion at vertices: COLOR_0 multiplies the base colour in every viewer.
corners = at.bake(scene, folder / "occlusion.glb", spp=64)
print(f"{corners.path.name}: {corners.receivers} vertices, {corners.mean:.3f} of the sky is open on average")

# A sun and a sky as a texture. The base colour is multiplied in, and viewers show it without lights of their own.
sun = at.DirectionalLight((-0.7, -0.8, -0.3), intensity=3.0)
sky = at.AmbientOcclusion(intensity=1.0)
lit = at.bake(scene, folder / "lit.glb", "light", lights=[sun, sky], texture=256, spp=16, exr=True)
print(
    f"{lit.path.name}: {lit.receivers} texels, exposure {lit.exposure:.2f}; the light itself is in {lit.images[0].name}"
)
