"""Small scenes that come with the package and under its licence, so that pages and programs run anywhere.

``example:NAME`` names them on the command line and in `antumbra.load`.
"""

from typing import TYPE_CHECKING

from ..formats.example_files import EXAMPLES, Example, file_of

if TYPE_CHECKING:
    from ..engine.paged_scene import PagedScene
    from ..engine.scene import Scene


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
