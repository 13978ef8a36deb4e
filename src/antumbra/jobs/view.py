"""Where points lie in a camera's picture."""

import numpy as np

from ..scene.camera import Camera, ExplicitRays


def projected(camera: Camera, points: np.ndarray) -> np.ndarray:
    """(k, 2) float64: pixels to the right and down, of world points; NaN behind the camera."""
    rays = camera.view(camera.position)
    away = points - camera.position
    if isinstance(rays, ExplicitRays):
        return rays.places(away)
    right, down, view = camera.axes
    depth = away @ view
    scale = camera.height / (2.0 * np.tan(np.radians(camera.vfov) / 2.0))
    with np.errstate(divide="ignore", invalid="ignore"):
        flat = np.stack([away @ right, away @ down], 1) / depth[:, None]
    flat[depth <= 0.0] = np.nan
    return flat * scale + (camera.width / 2.0, camera.height / 2.0)
