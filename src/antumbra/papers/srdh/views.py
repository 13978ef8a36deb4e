"""Views of the SRDH benchmark: real scenes with area lights, and procedural ones with much occlusion."""

from .. import views
from ..views import View, real_path, square

REAL = ("sponza_crytek", "zdm2", "godot_room", "bart_robots", "sanmiguel_lite")
"""Folders of $ANTUMBRA_SCENES that are measured if they exist. Each has a scene.glb and an info.json."""

MADE = ("blinds", "cellar", "atrium")
"""Procedural scenes. The first is always measured, the others only if there is no real scene."""


def default_names() -> list[str]:
    """The scenes that are measured if none is named."""
    real = [name for name in REAL if real_path(name)]
    return [*real, MADE[0]] if real else list(MADE)


def named_view(name: str, size: tuple[int, int]) -> View:
    """The view of a folder of $ANTUMBRA_SCENES, of a procedural scene, or of a scene file."""
    return views.named_view(name, size, square(10), REAL)
