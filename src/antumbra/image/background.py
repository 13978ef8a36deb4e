"""What pixels show that see no surface: the light of skies."""

import numpy as np

from ..scene.camera import CameraRays
from ..scene.listed_rays import ListedRays
from ..scene.sky import Sky


def skies_of(lights) -> list[Sky]:
    """The skies among some lights."""
    return [light for light in lights if isinstance(light, Sky)]


def sky_behind(skies: list[Sky], rays: CameraRays | ListedRays, rows: np.ndarray, columns: np.ndarray) -> np.ndarray:
    """(m, 3) float32: the radiance of skies through the centres of pixels (rows[i], columns[i]), or 0."""
    out = np.zeros((len(rows), 3), np.float32)
    if skies and len(rows):
        half = np.float32(0.5)
        directions = rays.directions(columns.astype(np.float32) + half, rows.astype(np.float32) + half)
        for sky in skies:
            out += sky.radiance(directions)
    return out
