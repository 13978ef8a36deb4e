"""Receivers of a scene, as tests compare them."""

import numpy as np

from antumbra.query.receivers import Receivers


def receivers_of(scene, points: np.ndarray, normals) -> tuple[np.ndarray, np.ndarray | None]:
    """(n, 3) float32 receivers of world points in the recentred frame; and (n, 3) float64 unit normals, if any."""
    made = Receivers.of(points, normals, scene.origin, scene.middle)
    return made.origins[0], None if normals is None else made.normals[0]
