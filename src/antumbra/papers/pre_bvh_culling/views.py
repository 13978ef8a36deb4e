"""The four views of the pre-BVH culling paper, reconstructed from its pictures; `video` has its animation."""

from pathlib import Path
from typing import NamedTuple

import numpy as np

from ...engine.scene import Scene, procedural
from ...engine.scene_loading import load
from ...errors import InputError
from ...scene.camera import Camera
from ...scene.lights import Light, QuadLight
from ..views import real_path

_SPONZA = {
    "Figure 3": ((-1150.0, 120.0, -180.0), (200.0, 420.0, 60.0)),
    "Figure 4": ((1180.0, 230.0, -40.0), (-1100.0, 150.0, 20.0)),
    "Figure 5": ((-1020.0, 640.0, 420.0), (700.0, 520.0, 330.0)),
}
"""Figure -> position and target of the camera: along the court, over the whole court, and in the upper gallery."""


class CullingView(NamedTuple):
    """A view of the paper."""

    figure: str
    scene: Scene
    camera: Camera
    lights: list[Light]
    time: float = 0.0  # seconds into the animation


def culling_views(sponza: Path | None, size: tuple[int, int], cellar_triangles: int) -> list[CullingView]:
    """The views of Figures 3 to 5, in Crytek's Sponza, and of Figure 6, in a procedural cellar.

    Sponza is a file in centimetres, or $ANTUMBRA_SCENES/sponza_crytek/scene.glb. Without it, one view of the procedural
    atrium, with as many triangles, takes the place of the first three.
    """
    cellar = procedural("cellar", triangles=cellar_triangles)
    last = CullingView("Figure 6", cellar, cellar.cameras[0].resized(*size), list(cellar.lights))
    path = real_path("sponza_crytek") if sponza is None else sponza
    if path is None:
        atrium = procedural("atrium", triangles=262_267)
        return [CullingView("atrium", atrium, atrium.cameras[0].resized(*size), list(atrium.lights)), last]
    if not path.exists():
        raise InputError(f"{path}: there is no such file; name Crytek's Sponza, or leave --sponza out")
    scene = load(path)
    return [_in_sponza(figure, scene, size) for figure in _SPONZA] + [last]


def _in_sponza(figure: str, scene: Scene, size) -> CullingView:
    """A view in Sponza, with two area lights: a large one over the open roof, and a smaller one behind the camera."""
    position, target = (np.array(p) for p in _SPONZA[figure])
    above = QuadLight((-900.0, 1400.0, -250.0), (1800.0, 0.0, 0.0), (0.0, 0.0, 450.0), intensity=2e6)
    ahead = (target - position) / np.linalg.norm(target - position)
    u = np.cross(ahead, (0.0, 1.0, 0.0))
    u, v = 120.0 * u / np.linalg.norm(u), 120.0 * np.cross(u / np.linalg.norm(u), ahead)
    behind = QuadLight(position - 60.0 * ahead + (0.0, 120.0, 0.0) - (u + v) / 2, u, v, intensity=3e5)
    return CullingView(
        figure, scene, Camera(position, target, vfov=60.0, width=size[0], height=size[1]), [above, behind]
    )
