"""Triangles: a scene at one moment, ready for kernels."""

from typing import NamedTuple

import numpy as np


class Triangles(NamedTuple):
    """A triangle soup in the recentred frame of its scene. World position = vertices + origin."""

    vertices: np.ndarray  # (n, 3, 3) float32, recentred frame, C-contiguous
    origin: np.ndarray  # (3,) float64, world position of the frame's zero
    face_id: np.ndarray  # (n,) int32, index of the face in the scene; the same at every time
    colour: np.ndarray  # (n, 3) float32, linear base colour in [0, 1]
