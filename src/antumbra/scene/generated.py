"""Procedural scenes as `Scene` objects."""

import numpy as np

from .camera import Camera
from .lights import QuadLight
from .mesh import make_mesh
from .scene import Scene
from .source import StaticMeshes


class _Generated(StaticMeshes):
    """A mesh with the camera and the light that suit it."""

    def __init__(self, meshes, file, camera, light):
        super().__init__(meshes, file)
        self._camera, self._light = camera, light

    def cameras(self, time: float) -> list:
        return [self._camera]

    def lights(self, time: float) -> list:
        return [self._light]


def procedural(name: str = "atrium", triangles: int | None = None, seed: int = 0) -> Scene:
    """A procedural scene with a camera and a quad light; the same for the same arguments, everywhere.

    Parameters
    ----------
    name : "atrium", "city", "forest", "cellar", "museum" or "blinds"
    triangles : int, optional
        About how many (within 10 %); each scene has its own default.
    seed : int
        Other seeds scatter the clutter differently.

    Raises
    ------
    InputError
        On an unknown name, or a number of triangles out of range.
    """
    from .procedural import generate

    made = generate(name, triangles, seed)
    colour = np.asarray(made.palette, np.float32)[made.colour]
    mesh = make_mesh(name, made.vertices, made.faces, colour, f"procedural {name}")
    camera, light = Camera(**made.camera), QuadLight(**made.light)
    return Scene(_Generated([mesh], f"procedural {name}", camera, light), name=name)
