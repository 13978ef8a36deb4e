"""What the benchmark of SRDH looks at: real scenes with area lights, and generated ones with much occlusion."""

from .. import views
from ..views import View, real_path, square

REAL = ("sponza_crytek", "zdm2", "godot_room", "bart_robots", "sanmiguel_lite")
"""Folders of $ANTUMBRA_SCENES that are looked at where they are there, each a scene.glb and an info.json."""

MADE = ("blinds", "cellar", "atrium")
"""Of the procedural scenes the first is always looked at, the others where there is no real one."""


def default_names() -> list[str]:
    """What is looked at if nothing is named."""
    real = [name for name in REAL if real_path(name)]
    return [*real, MADE[0]] if real else list(MADE)


def named_view(name: str, size: tuple[int, int]) -> View:
    """The view of a folder of $ANTUMBRA_SCENES, of a procedural scene, or of a scene file."""
    return views.named_view(name, size, square(10), REAL)
