"""The input of tracers without a BVH: the unsorted triangles."""

from typing import NamedTuple

import numpy as np

from ..cull.cull import Culled
from ..scene.areas import solid_vertices
from ..scene.triangles import Triangles


class Soup(NamedTuple):
    """All or some triangles of a scene, in scene order."""

    corners: np.ndarray  # (n, 9) float32, recentred frame, C-contiguous
    ids: np.ndarray  # (n,) int32, ascending: index of each triangle in the scene


def soup_of(triangles: Triangles, culled: Culled | None = None, threads: int | None = None) -> Soup:
    """The `Soup` of the solid triangles of a scene, or of those left by culling; without copies if all are solid."""
    if culled is not None:
        return Soup(culled.vertices.reshape(-1, 9), culled.kept)
    if triangles.solid is not None:
        return Soup(solid_vertices(triangles, threads).reshape(-1, 9), triangles.solid)
    return Soup(triangles.vertices.reshape(-1, 9), np.arange(len(triangles.vertices), dtype=np.int32))
