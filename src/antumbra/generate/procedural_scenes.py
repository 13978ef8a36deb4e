"""The registry of procedural scenes, and `generate`, which makes one of them by name."""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from .. import extras as plugins
from ..checks import quoted, spelling_hint
from ..errors import InputError
from .atrium import atrium
from .city import city, city_blocks, city_view
from .forest import forest
from .palette import MAX_TRIANGLES, MIN_TRIANGLES, PALETTE, check_request

# --- The registry of procedural scenes, and `generate`, which makes one of them ---------------------------------------


class ProceduralScene(NamedTuple):
    """A generated scene: metres, +Y up, right-handed."""

    vertices: np.ndarray  # (v, 3) float32
    faces: np.ndarray  # (f, 3) int32, counter-clockwise seen from outside
    colour: np.ndarray  # (f,) uint8, rows of the palette
    palette: np.ndarray  # (256, 3) float32, linear
    camera: dict  # position, target, up: (3,) tuples of float; vfov: degrees
    light: dict  # a quad: corner, u, v: (3,) tuples of float


class Recipe(NamedTuple):
    """The function that makes a scene, with its description and default size."""

    function: Callable  # (triangles, seed) -> mesh, camera, light
    description: str
    default_triangles: int


PROCEDURAL = {
    "atrium": Recipe(atrium, "a two-storey arcaded courtyard with a fountain, plants and banners", 100_000),
    "city": Recipe(city, "streets and blocks of houses and towers around a park", 500_000),
    "forest": Recipe(forest, "a path through trees, ferns and grass", 300_000),
}
"""All scenes by name."""


def register(name: str, recipe: Recipe) -> None:
    """Add a scene."""
    PROCEDURAL[name] = recipe


def add_scenes() -> None:
    """Add the scenes of all packages with an entry point ``antumbra.scenes``."""
    plugins.load_plugins("antumbra.scenes")


def find_scene(name: str) -> Recipe:
    """The recipe of a scene, also of a scene that another package adds.

    Raises
    ------
    InputError
        On an unknown name.
    """
    if not isinstance(name, str):
        raise InputError(f"name is {quoted(name)}; choose one of {', '.join(PROCEDURAL)}")
    if name not in PROCEDURAL:
        add_scenes()
    if name not in PROCEDURAL:
        cure = f"{spelling_hint(name, PROCEDURAL)}choose one of {', '.join(PROCEDURAL)}"
        raise InputError(f"there is no procedural scene {name!r}; {cure}")
    return PROCEDURAL[name]


def generate(name: str, triangles: int | None = None, seed: int = 0) -> ProceduralScene:
    """Make the scene `name`. Equal arguments give the same scene.

    Parameters
    ----------
    name : str
        A key of `PROCEDURAL`, or of a package's scenes.
    triangles : int, optional
        `request.LEAST` to `request.MOST`, met within 10 % from 10 000 on. Below that, a scene may have more, since
        it has a coarsest version. The default is the recipe's.
    seed : int
        0 or more. Another seed places and shapes things differently.

    Raises
    ------
    InputError
        On an unknown name, a number of triangles out of range, or a negative seed.
    """
    recipe = find_scene(name)
    triangles, seed = check_request(name, recipe.default_triangles if triangles is None else triangles, seed)
    mesh, camera, light = recipe.function(triangles, seed)
    camera = {key: _plain(value) for key, value in camera.items()}
    light = {key: _plain(value) for key, value in light.items()}
    return ProceduralScene(mesh.vertices, mesh.faces, mesh.colour, PALETTE, camera, light)


def _plain(value):
    """A vector as a tuple of Python floats, a number as a float."""
    return tuple(float(x) for x in value) if np.ndim(value) else float(value)


# --- Procedural scenes of any size, without a file: atrium, city, forest, and scenes that other packages add ----------
#
# - recipes: the registry of scenes, and `generate`; request: the checks of its arguments
# - atrium, courtyard: a court with arcades; city, buildings: streets and houses
# - forest, trees, plants: a path through trees
# - architecture, props: parts of buildings, and things that stand in them
# - parts: copies of meshes, counted and assembled; shapes: small closed meshes; palette: the materials
# - stream: the city as a stream of blocks, by several processes


__all__ = [
    "MAX_TRIANGLES",
    "MIN_TRIANGLES",
    "PALETTE",
    "PROCEDURAL",
    "ProceduralScene",
    "Recipe",
    "add_scenes",
    "city_blocks",
    "city_view",
    "find_scene",
    "generate",
    "register",
]
