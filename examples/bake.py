"""Bake ambient occlusion and sunlight into glTF files: python examples/bake.py [FOLDER]

The scene is the temple that comes with the package. The texture needs an atlas: pip install 'antumbra[bake]'
"""

import sys
import tempfile
from pathlib import Path

import antumbra as at

folder = Path(sys.argv[1] if len(sys.argv) > 1 else tempfile.mkdtemp())
scene = at.examples.file_of("temple")

# Ambient occlusion at vertices: COLOR_0 multiplies the base colour in every viewer.
corners = at.bake(scene, folder / "occlusion.glb", spp=64)
print(f"{corners.path.name}: {corners.receivers} vertices, {corners.mean:.3f} of the sky is open on average")

# Sun and sky light, with one bounce, as a lightmap: loaders for viewers are in examples/lightmaps.
sun = at.DirectionalLight((-0.7, -0.8, -0.3), intensity=3.0)
sky = at.AmbientOcclusion(intensity=1.0)
lit = at.bake(scene, folder / "lit.glb", "light", lights=[sun, sky], bounces=1, texture=256, spp=16, exr=True)
print(
    f"{lit.path.name}: {lit.receivers} texels, exposure {lit.exposure:.2f}; the light itself is in {lit.images[0].name}"
)
