"""Antumbra: which points see which lights, exactly and fast.

>>> import antumbra as at
>>> scene = at.procedural("atrium", triangles=5_000)
>>> frame = at.render(scene, scene.cameras[0].resized(64, 64), scene.lights, spp=16)
>>> frame.visibility[0].shape
(64, 64)
"""

from .errors import InputError
from .plan import Plan
from .queries import Visibility, visibility
from .query.gbuffer import GBuffer
from .query.rays import Hit
from .renderer import Frame, Renderer, render
from .scene.camera import Camera
from .scene.generated import procedural
from .scene.lights import DirectionalLight, DiskLight, Light, PointLight, QuadLight, SphereLight
from .scene.load import load
from .scene.scene import Scene
from .scene.triangles import Triangles

__version__ = "0.1.0"

__all__ = [
    "Camera",
    "DirectionalLight",
    "DiskLight",
    "Frame",
    "GBuffer",
    "Hit",
    "InputError",
    "Light",
    "Plan",
    "PointLight",
    "QuadLight",
    "Renderer",
    "Scene",
    "SphereLight",
    "Triangles",
    "Visibility",
    "load",
    "procedural",
    "render",
    "visibility",
]
