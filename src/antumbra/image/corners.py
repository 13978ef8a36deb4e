"""Where a point lies on its triangle: weights of the corners, for whatever changes from corner to corner."""

from typing import NamedTuple

import numpy as np

from ..kernels.jit import inlined
from ..kernels.predicate.filters import cross, dot
from ..query.shadow_query import Surfaces, three_at


class Places(NamedTuple):
    """The points that pixels see, and their triangles."""

    position: np.ndarray  # (H, W, 3) float32
    normal: np.ndarray  # (H, W, 3) float32, geometric
    depth: np.ndarray  # (H, W) float32
    face: np.ndarray  # (H, W) int32, index in `corners`
    ids: np.ndarray  # (H, W) int32, face of the scene; -1: nothing is seen
    corners: np.ndarray  # (n, 9) float32


def places_of(surfaces: Surfaces) -> Places:
    g = surfaces.gbuffer
    return Places(g.position, g.normal, g.depth, g.face, surfaces.ids, surfaces.triangles.vertices.reshape(-1, 9))


class Frame3(NamedTuple):
    """A triangle's edges from its first corner, their cross product, and its squared length; float64 vectors."""

    e1: tuple
    e2: tuple
    g: tuple
    g2: float


@inlined
def minus(a, b):
    return a[0] - b[0], a[1] - b[1], a[2] - b[2]


@inlined
def frame_of(corners, i):
    """The `Frame3` of triangle i; `corners` is a pointer."""
    c0 = three_at(corners, 3 * i)
    e1, e2 = minus(three_at(corners, 3 * i + 1), c0), minus(three_at(corners, 3 * i + 2), c0)
    g = cross(e1, e2)
    return Frame3(e1, e2, g, dot(g, g))


@inlined
def along(frame, d):
    """How the weights of the second and third corner change along the vector d."""
    return dot(cross(d, frame.e2), frame.g) / frame.g2, dot(cross(frame.e1, d), frame.g) / frame.g2


@inlined
def weights(frame, corners, i, p):
    """(b0, b1, b2): the weights of the corners of triangle i at its point p, in [0, 1]; a third each without area."""
    if not frame.g2 > 0.0:
        return 1.0 / 3.0, 1.0 / 3.0, 1.0 / 3.0
    b1, b2 = along(frame, minus(p, three_at(corners, 3 * i)))
    b1 = min(max(b1, 0.0), 1.0)
    b2 = min(max(b2, 0.0), 1.0 - b1)
    return 1.0 - b1 - b2, b1, b2
