"""Small scenes that come with the package and under its licence, so that pages and programs run anywhere.

On the command line, ``example:NAME`` names them.
"""

from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

from ..base.checks import quoted, spelling_hint
from ..base.errors import InputError

if TYPE_CHECKING:
    from ..engine.paged_scene import PagedScene
    from ..engine.scene import Scene


class Example(NamedTuple):
    """A scene in this folder."""

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
    return Path(__file__).parent / EXAMPLES[name].file


def _load(name: str) -> "Scene | PagedScene":
    from ..engine.scene_loading import load

    return load(file_of(name))


def hills() -> "Scene | PagedScene":
    """Heights: hills of one square kilometre in EPSG:28992, cells of 8 m. Requires antumbra[gis]."""
    return _load("hills")


def mill() -> "Scene | PagedScene":
    """A windmill whose sails turn: 3,818 triangles, a texture of bricks, and an animation of 4 seconds."""
    return _load("mill")


def room() -> "Scene | PagedScene":
    """A closed hall with columns, a table, shelves, vases and plants: 29,088 triangles in 12 objects."""
    return _load("room")


def temple() -> "Scene | PagedScene":
    """A temple of fluted columns under a roof of tiles: 51,784 triangles in 7 objects.

    Examples
    --------
    >>> at.examples.temple()
    Scene('temple', 51,784 triangles, up='y')
    """
    return _load("temple")


def town() -> "Scene | PagedScene":
    """Houses, trees, cars and lamps along two streets: 75,784 triangles in 65 objects."""
    return _load("town")


def village() -> "Scene | PagedScene":
    """CityJSON: a street with houses and trees on the slopes of `hills`, in EPSG:7415. Requires antumbra[gis]."""
    return _load("village")


__all__ = ["EXAMPLES", "Example", "file_of", "hills", "mill", "room", "temple", "town", "village"]
