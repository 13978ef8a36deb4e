"""Small open scenes that come with the package, so that pages and programs run anywhere.

LICENCES.md beside this file has their authors and licences. On the command line, ``example:NAME`` names them.
"""

from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

from ..checks import quoted, spelling_hint
from ..errors import InputError

if TYPE_CHECKING:
    from ..engine.paged_scene import PagedScene
    from ..engine.scene import Scene


class Example(NamedTuple):
    """A scene in this folder."""

    file: str
    description: str
    licence: str


EXAMPLES = {
    "fox": Example("fox.glb", "a fox that walks, with a texture", "CC-BY 4.0"),
    "hills": Example("hills.tif", "heights of hills in EPSG:28992, one square kilometre", "Apache 2.0"),
    "room": Example("room.glb", "a room with doorways, and columns of spheres", "MIT"),
    "temple": Example("temple.glb", "a Japanese temple", "CC-BY 4.0"),
    "town": Example("town.glb", "a small town with a race track", "MIT"),
    "village": Example("village.city.json", "houses on the hills in EPSG:7415, CityJSON", "Apache 2.0"),
}
"""All scenes by name."""


def file_of(name: str) -> Path:
    """The file of an example scene, to copy it or to pass it to another program.

    Parameters
    ----------
    name : str
        "fox", "hills", "room", "temple", "town" or "village".

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


def fox() -> "Scene | PagedScene":
    """A fox that walks: 576 triangles with a texture, an animation. CC-BY 4.0, by PixelMannen, tomkranis and others."""
    return _load("fox")


def hills() -> "Scene | PagedScene":
    """Heights: hills of one square kilometre in EPSG:28992, cells of 8 m. Requires antumbra[gis]. Apache 2.0."""
    return _load("hills")


def room() -> "Scene | PagedScene":
    """A room with doorways and columns of spheres: 63,720 triangles. MIT, by the Godot Engine contributors."""
    return _load("room")


def temple() -> "Scene | PagedScene":
    """A Japanese temple: 29,696 triangles. CC-BY 4.0, by Aditya3D."""
    return _load("temple")


def town() -> "Scene | PagedScene":
    """A small town with a race track: 30,345 triangles in 60 objects. MIT, by the Godot Engine contributors."""
    return _load("town")


def village() -> "Scene | PagedScene":
    """CityJSON: houses on the slopes of `hills`, in EPSG:7415. Requires antumbra[gis]. Apache 2.0."""
    return _load("village")


__all__ = ["EXAMPLES", "Example", "file_of", "fox", "hills", "room", "temple", "town", "village"]
