"""The input of tracers without a BVH: the triangles, unsorted."""

from typing import NamedTuple

import numpy as np

from ..cull.cull import Culled
from ..scene.triangles import Triangles


class Soup(NamedTuple):
    """Triangles in the order of the scene; perhaps only some of them."""

    corners: np.ndarray  # (n, 9) float32, recentred frame, C-contiguous
    ids: np.ndarray  # (n,) int32, ascending: which of the scene's triangles each is


def soup_of(triangles: Triangles, culled: Culled | None = None) -> Soup:
    """All triangles of a scene, or the triangles left by culling; without copies."""
    if culled is not None:
        return Soup(culled.vertices.reshape(-1, 9), culled.kept)
    return Soup(triangles.vertices.reshape(-1, 9), np.arange(len(triangles.vertices), dtype=np.int32))
