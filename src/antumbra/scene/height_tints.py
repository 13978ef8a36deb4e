"""The colours of terrain in pictures, by height, as on maps: from meadows in valleys to rock and snow.

A scene of nothing but terrain has no colours of its own. These are for the eye alone: `Scene.colours`, bounced light
and bakes keep the plain colour of terrain. They follow from the points that a picture shows, so scenes in memory and
after an update, stores and lists of tiles all have them.
"""

import numpy as np
from numpy.typing import NDArray

from .materials import srgb_to_linear
from .scene_data import SceneData

_STOPS = {
    0.0: (0.25, 0.39, 0.20),
    0.28: (0.42, 0.48, 0.25),
    0.5: (0.58, 0.49, 0.30),
    0.75: (0.45, 0.35, 0.29),
    0.93: (0.62, 0.58, 0.55),
    1.0: (0.95, 0.95, 0.94),
}
"""Share of the height, from the lowest to the highest point of the scene -> sRGB."""

_LEVELS = 256


def _ramp() -> NDArray[np.float32]:
    """(256, 3) float32: linear colours of equal steps in height."""
    shares, colours = np.linspace(0.0, 1.0, _LEVELS), np.array(list(_STOPS.values()))
    rows = [np.interp(shares, list(_STOPS), channel) for channel in colours.T]
    return srgb_to_linear(np.stack(rows, 1)).astype(np.float32)


_RAMP = _ramp()


def height_tints(scene: SceneData, points: NDArray[np.float32]) -> NDArray[np.float32] | None:
    """The linear colours of points, both (..., 3) float32; None for a scene that has colours of its own.

    points : recentred

    The highest and the lowest point of the scene are the ends of the ramp. Level terrain has the colour of meadows.
    """
    if not scene.of_heights or scene.has_looks:
        return None
    axis = "xyz".index(scene.up)
    low, high = scene.bounds[:, axis] - scene.origin[axis]
    scale = np.float32((_LEVELS - 1) / (high - low) if high > low else 0.0)
    steps = (points[..., axis] - np.float32(low)) * scale
    out: NDArray[np.float32] = _RAMP[np.clip(np.nan_to_num(steps), 0, _LEVELS - 1).astype(np.uint8)]
    return out
