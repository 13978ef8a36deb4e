"""Where points lie in a camera's picture."""

import numpy as np

from ..scene.camera import Camera


def projected(camera: Camera, points: np.ndarray) -> np.ndarray:
    """(k, 2) float64: pixels to the right and down, of world points; NaN behind the camera."""
    view = _unit(camera.target - camera.position)
    right = _unit(np.cross(view, camera.up))
    away = points - camera.position
    depth = away @ view
    scale = camera.height / (2.0 * np.tan(np.radians(camera.vfov) / 2.0))
    with np.errstate(divide="ignore", invalid="ignore"):
        flat = np.stack([away @ right, away @ np.cross(view, right)], 1) / depth[:, None]
    flat[depth <= 0.0] = np.nan
    return flat * scale + (camera.width / 2.0, camera.height / 2.0)


def _unit(v: np.ndarray) -> np.ndarray:
    return v / np.linalg.norm(v)
