"""Procedural scenes like those of the papers: `cellar`, `museum` and `blinds`, with their parts.

Only the benchmarks of the papers need them.
"""

from ...generate.procedural_scenes import Recipe, register
from .bedroom import blinds
from .cellar import cellar
from .museum_halls import museum

SCENES = {
    "cellar": Recipe(cellar, "vaulted rooms on several levels, of which little can be seen at once", 250_000),
    "museum": Recipe(museum, "halls of sculptures, with most triangles in a few of them", 300_000),
    "blinds": Recipe(blinds, "a bedroom into which light comes through the slats of blinds only", 300_000),
}


def add() -> None:
    """Register the scenes (entry point ``antumbra.scenes``)."""
    for name, recipe in SCENES.items():
        register(name, recipe)
