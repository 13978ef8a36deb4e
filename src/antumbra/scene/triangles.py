"""Triangles: a scene at one moment, ready for kernels."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from .cutouts import Cutouts


class Triangles(NamedTuple):
    """A triangle soup in the recentred frame of its scene. World position = vertices + origin."""

    vertices: np.ndarray  # (n, 3, 3) float32, recentred frame, C-contiguous
    origin: np.ndarray  # (3,) float64, world position of the frame's zero
    face_id: np.ndarray  # (n,) int32, index of the face in the scene; the same at every time
    colour: np.ndarray  # (n, 3) float32, linear base colour in [0, 1]
    cutouts: Cutouts | None = None  # faces with holes, and those without; None: all faces are solid
    solid: np.ndarray | None = None  # (k,) int32, ascending: rows with an area and without a hole; None: all rows

    def __repr__(self) -> str:
        return f"Triangles({len(self.vertices)} triangles; {', '.join(self._fields)})"


def joined(several: Sequence[Triangles]) -> Triangles:
    """Several soups of the same frame as one."""
    if len(several) == 1:
        return several[0]
    vertices, ids, colour = (
        np.concatenate([getattr(each, name) for each in several]) for name in ("vertices", "face_id", "colour")
    )
    return Triangles(vertices, several[0].origin, ids, colour)
