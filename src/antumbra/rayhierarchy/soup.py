"""The input of tracers without a BVH: the unsorted triangles."""

from typing import NamedTuple

import numpy as np

from ..cull.cull import Culled
from ..scene.triangles import Triangles


class Soup(NamedTuple):
    """All or some triangles of a scene, in scene order."""

    corners: np.ndarray  # (n, 9) float32, recentred frame, C-contiguous
    ids: np.ndarray  # (n,) int32, ascending: index of each triangle in the scene


def soup_of(triangles: Triangles, culled: Culled | None = None) -> Soup:
    """The `Soup` of all triangles of a scene, or of the triangles left by culling, without copies."""
    if culled is not None:
        return Soup(culled.vertices.reshape(-1, 9), culled.kept)
    return Soup(triangles.vertices.reshape(-1, 9), np.arange(len(triangles.vertices), dtype=np.int32))
