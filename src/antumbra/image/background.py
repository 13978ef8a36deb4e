"""What pixels show that see no surface: the light of skies, or a backdrop."""

import numpy as np

from ..scene.camera import CameraRays, ExplicitRays
from ..scene.sky import Sky

BACKDROP = 0.75
"""Share of white that a backdrop shows where the soft daylight has a radiance of 1."""


def backdrop(rays: CameraRays | ExplicitRays, coverage: np.ndarray, up: str) -> np.ndarray:
    """(H, W, 3) float32, linear shares of white: a soft daylight behind a scene that no sky lights.

    It sheds no light, and no exposure changes it. It is 0 where surfaces cover the whole pixel.

    coverage : (H, W) float32, the share of each pixel that shows surfaces
    """
    out, (rows, columns) = np.zeros((*coverage.shape, 3), np.float32), np.nonzero(coverage < 1.0)
    out[rows, columns] = sky_behind([Sky(up=up, intensity=BACKDROP)], rays, rows, columns)
    return out


def skies_of(lights) -> list[Sky]:
    """The skies among some lights."""
    return [light for light in lights if isinstance(light, Sky)]


def sky_behind(skies: list[Sky], rays: CameraRays | ExplicitRays, rows: np.ndarray, columns: np.ndarray) -> np.ndarray:
    """(m, 3) float32: the radiance of skies through the centres of pixels (rows[i], columns[i]), or 0."""
    out = np.zeros((len(rows), 3), np.float32)
    if skies and len(rows):
        half = np.float32(0.5)
        directions = rays.directions(columns.astype(np.float32) + half, rows.astype(np.float32) + half)
        for sky in skies:
            out += sky.radiance(directions)
    return out
