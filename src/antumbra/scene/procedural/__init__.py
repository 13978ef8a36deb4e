"""Procedural scenes of any size, without a file: atrium, city, forest, and scenes that other packages add.

- recipes: the registry of scenes, and `generate`; request: the checks of its arguments
- atrium, courtyard: a court with arcades; city, buildings: streets and houses
- forest, trees, plants: a path through trees
- architecture, props: parts of buildings, and things that stand in them
- parts: copies of meshes, counted and assembled; shapes: small closed meshes; palette: the materials
- stream: the city as a stream of blocks, by several processes
"""

from .city import city_blocks, city_view
from .palette import PALETTE
from .recipes import PROCEDURAL, ProceduralScene, Recipe, add_scenes, find_scene, generate, register
from .request import LEAST, MOST

__all__ = [
    "LEAST",
    "MOST",
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
