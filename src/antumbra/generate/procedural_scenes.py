"""The registry of procedural scenes, and `generate`, which generates one by name."""

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from ..base import extras
from ..base.checks import quoted, spelling_hint
from ..base.errors import InputError
from ..scene.palette_scene import PaletteScene
from .atrium import atrium
from .city import city, city_blocks, city_view
from .forest import forest
from .palette import MAX_TRIANGLES, MIN_TRIANGLES, PALETTE, check_request
from .shapes import PaletteMesh


class Recipe(NamedTuple):
    """The generator function of a scene, with its description and default size."""

    function: Callable[
        [int, int], tuple[PaletteMesh, dict[str, Any], dict[str, Any]]
    ]  # (triangles, seed) -> mesh, camera, light
    description: str
    default_triangles: int


PROCEDURAL = {
    "atrium": Recipe(atrium, "a two-storey arcaded courtyard with a fountain, plants and banners", 100_000),
    "city": Recipe(city, "streets and blocks of houses and towers around a park", 500_000),
    "forest": Recipe(forest, "a path through trees, ferns and grass", 300_000),
}
"""All scenes by name."""


def register(name: str, recipe: Recipe) -> None:
    """Register a scene."""
    PROCEDURAL[name] = recipe


def load_plugin_scenes() -> None:
    """Register the scenes of all packages with an entry point ``antumbra.scenes``."""
    extras.load_plugins("antumbra.scenes")


def find_scene(name: str) -> Recipe:
    """The recipe of a scene, including scenes from other packages.

    Raises
    ------
    InputError
        On an unknown name.
    """
    if not isinstance(name, str):
        raise InputError(f"name is {quoted(name)}; choose one of {', '.join(PROCEDURAL)}")
    if name not in PROCEDURAL:
        load_plugin_scenes()
    if name not in PROCEDURAL:
        cure = f"{spelling_hint(name, PROCEDURAL)}choose one of {', '.join(PROCEDURAL)}"
        raise InputError(f"there is no procedural scene {name!r}; {cure}")
    return PROCEDURAL[name]


def generate(name: str, triangles: int | None = None, seed: int = 0) -> PaletteScene:
    """Generate the scene `name`. Equal arguments give the same scene.

    Parameters
    ----------
    name : str
        A key of `PROCEDURAL`, or the name of a scene from another package.
    triangles : int, optional
        `MIN_TRIANGLES` to `MAX_TRIANGLES`, met within 10 % from 10 000 on. Below that, a scene may have more, since its
        coarsest version has a minimum size. The default is the recipe's.
    seed : int
        0 or more. Varies the placement and shape of things.

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
    return PaletteScene(mesh.vertices, mesh.faces, mesh.colour, PALETTE, camera, light)


def _plain(value: Any) -> float | tuple[float, ...]:
    """A vector as a tuple of Python floats, a number as a float."""
    return tuple(float(x) for x in value) if np.ndim(value) else float(value)


__all__ = [
    "MAX_TRIANGLES",
    "MIN_TRIANGLES",
    "PALETTE",
    "PROCEDURAL",
    "Recipe",
    "city_blocks",
    "city_view",
    "find_scene",
    "generate",
    "load_plugin_scenes",
    "register",
]
