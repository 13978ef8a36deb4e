"""Procedural scenes like those of the papers; only the benchmarks need them.

- `cellar`: the scene ``cellar``
- `museum_halls`: the scene ``museum``
- `bedroom`: the scene ``blinds``
- `furnishings`: furniture and toys of the bedroom
"""

from ....generate.procedural_scenes import Recipe, register
from .bedroom import blinds
from .cellar import cellar
from .museum_halls import museum

SCENES = {
    "cellar": Recipe(cellar, "vaulted rooms on several levels, with little visible at once", 250_000),
    "museum": Recipe(museum, "halls of sculptures, with most triangles in a few of them", 300_000),
    "blinds": Recipe(blinds, "a bedroom lit only through the slats of blinds", 300_000),
}


def add() -> None:
    """Register the scenes (entry point ``antumbra.scenes``)."""
    for name, recipe in SCENES.items():
        register(name, recipe)
