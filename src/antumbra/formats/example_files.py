"""Names of scenes: `example:NAME` for those that come with the package, and paths for all others."""

import os
from pathlib import Path
from typing import Any, NamedTuple

from ..base.checks import path_of, quoted, spelling_hint
from ..base.errors import InputError

EXAMPLE_PREFIX = "example:"
PROCEDURAL_PREFIX = "procedural:"

_FOLDER = Path(__file__).parents[1] / "examples"


class Example(NamedTuple):
    """A scene in the folder `examples` of the package."""

    file: str
    description: str


EXAMPLES = {
    "hills": Example("hills.tif", "heights of hills in EPSG:28992, one square kilometre"),
    "mill": Example("mill.glb", "a windmill whose sails turn, with a texture of bricks"),
    "room": Example("room.glb", "a closed hall with columns, a table and shelves"),
    "temple": Example("temple.glb", "a temple of fluted columns under a roof of tiles"),
    "town": Example("town.glb", "houses, trees, cars and lamps along two streets"),
    "village": Example("village.city.json", "a street with houses and trees on the hills in EPSG:7415, CityJSON"),
}
"""All scenes by name."""


def file_of(name: str) -> Path:
    """The file of an example scene, to copy it or to pass it to another program.

    Parameters
    ----------
    name : str
        "hills", "mill", "room", "temple", "town" or "village".

    Raises
    ------
    InputError
        On an unknown name.
    """
    if not isinstance(name, str) or name not in EXAMPLES:
        hint = spelling_hint(name, EXAMPLES) if isinstance(name, str) else ""
        raise InputError(f"there is no example scene {quoted(name)}; {hint}choose one of {', '.join(EXAMPLES)}")
    return _FOLDER / EXAMPLES[name].file


def scene_path(value: Any, what: str = "scene") -> Path:
    """The path of a scene, which may be named ``example:NAME``. Other names that begin so may be those of files.

    Raises
    ------
    InputError
        If `value`, which errors call `what`, is no path, names an unknown example, or a procedural scene.
    """
    path = path_of(value, what)
    name = str(path)
    if name.startswith(EXAMPLE_PREFIX):
        example = name.removeprefix(EXAMPLE_PREFIX)
        if example in EXAMPLES or not os.path.exists(path):
            return file_of(example)
    elif name.startswith(PROCEDURAL_PREFIX) and not os.path.exists(path):
        scene = name.removeprefix(PROCEDURAL_PREFIX).partition("?")[0]
        raise InputError(f'{what} is {quoted(name)}; in Python, call at.procedural("{scene}", triangles, seed)')
    return path
