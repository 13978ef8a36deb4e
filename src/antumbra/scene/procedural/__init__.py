"""Procedural scenes: atrium, city, forest, cellar, museum and a room behind blinds, at any size, without a file."""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from ...errors import InputError
from .atrium import atrium
from .blinds import blinds
from .cellar import cellar
from .city import city, city_blocks, city_view
from .forest import forest
from .museum import museum
from .palette import PALETTE
from .request import LEAST, MOST, checked

__all__ = [
    "LEAST",
    "MOST",
    "PALETTE",
    "PROCEDURAL",
    "ProceduralScene",
    "Recipe",
    "city_blocks",
    "city_view",
    "generate",
]


class ProceduralScene(NamedTuple):
    """A generated scene: metres, +Y up, right-handed."""

    vertices: np.ndarray  # (v, 3) float32
    faces: np.ndarray  # (f, 3) int32, counter-clockwise seen from outside
    colour: np.ndarray  # (f,) uint8, rows of the palette
    palette: np.ndarray  # (256, 3) float32, linear
    camera: dict  # position, target, up: (3,) tuples of float; vfov: degrees
    light: dict  # a quad: corner, u, v: (3,) tuples of float


class Recipe(NamedTuple):
    """How a scene is made."""

    function: Callable  # (triangles, seed) -> mesh, camera, light
    description: str
    default_triangles: int


PROCEDURAL = {
    "atrium": Recipe(atrium, "a two-storey arcaded courtyard with a fountain, plants and banners", 100_000),
    "city": Recipe(city, "streets and blocks of houses and towers around a park", 500_000),
    "forest": Recipe(forest, "a path through trees, ferns and grass", 300_000),
    "cellar": Recipe(cellar, "vaulted rooms on several levels, of which little can be seen at once", 250_000),
    "museum": Recipe(museum, "halls of sculptures, with most triangles in a few of them", 300_000),
    "blinds": Recipe(blinds, "a bedroom into which light comes through the slats of blinds only", 300_000),
}
"""The scenes by name."""


def generate(name: str, triangles: int | None = None, seed: int = 0) -> ProceduralScene:
    """The scene `name`, the same for the same arguments.

    Parameters
    ----------
    name : str
        A key of `PROCEDURAL`.
    triangles : int, optional
        `LEAST` to `MOST`. Met within 10 % from 10 000 on; below that a scene may have more, because there is a
        coarsest version of it. By default what suits the scene.
    seed : int
        0 or more; other seeds place and shape things differently.

    Raises
    ------
    InputError
        On an unknown name, a number of triangles out of range, or a negative seed.
    """
    if name not in PROCEDURAL:
        raise InputError(f"there is no procedural scene {name!r}; choose one of {', '.join(PROCEDURAL)}")
    recipe = PROCEDURAL[name]
    triangles, seed = checked(name, recipe.default_triangles if triangles is None else triangles, seed)
    mesh, camera, light = recipe.function(triangles, seed)
    camera = {key: _plain(value) for key, value in camera.items()}
    light = {key: _plain(value) for key, value in light.items()}
    return ProceduralScene(mesh.vertices, mesh.faces, mesh.colour, PALETTE, camera, light)


def _plain(value):
    """A vector as a tuple of Python floats, a number as a float."""
    return tuple(float(x) for x in value) if np.ndim(value) else float(value)
