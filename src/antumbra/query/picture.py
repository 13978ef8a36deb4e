"""What a picture asks: the shadow queries of the surfaces that its pixels see."""

from typing import NamedTuple

import numpy as np

from ..scene.lights import AMBIENT
from ..scene.triangles import Triangles
from .bounds import reach, reach_of
from .gbuffer import GBuffer
from .receivers import surface_receivers
from .shadow import ShadowQuery


class Surfaces(NamedTuple):
    """What a picture's rays meet, and the triangles that it is part of."""

    gbuffer: GBuffer  # its faces count in `triangles`
    triangles: Triangles  # all of the scene, or those that are met
    ids: np.ndarray  # (H, W) int32: index of the face in the scene; -1 where nothing is met
    box: np.ndarray | None = None  # (2, 3) float32: bounds of the whole scene; None: those of `triangles`


def surfaces_of(gbuffer: GBuffer, triangles: Triangles) -> Surfaces:
    """`Surfaces` where all triangles are there."""
    return Surfaces(gbuffer, triangles, gbuffer.face)


def shadow_queries(triangles, gbuffer, lights, samples, cull_faces=0, threads=None) -> list[ShadowQuery]:
    """The query of each light for the surfaces in a G-buffer; ``samples``: of each light from `light_samples`."""
    return surface_queries(surfaces_of(gbuffer, triangles), lights, samples, cull_faces, threads)


def surface_queries(surfaces: Surfaces, lights, samples, cull_faces=0, threads=None) -> list[ShadowQuery]:
    """The same for `Surfaces`."""
    gbuffer, triangles, ids, box = surfaces
    shape = gbuffer.face.shape
    corners = triangles.vertices.reshape(-1, 9)
    flat = (
        gbuffer.position.reshape(-1, 3),
        gbuffer.normal.reshape(-1, 3),
        gbuffer.face.reshape(-1),
        gbuffer.side.reshape(-1),
    )
    origins = surface_receivers(*flat, corners, threads).reshape(*shape, 3)
    far = 1.0
    if triangles.vertices.size:
        points = gbuffer.position
        far = reach(triangles, points, threads) if box is None else reach_of(box, points, threads)
    patches = [light.patch(triangles.origin, far) for light in lights]
    ambient = any(p.kind == AMBIENT for p in patches)
    normals = gbuffer.normal.astype(np.float64) if ambient else np.empty((0, 0, 3))
    return [
        ShadowQuery(origins, gbuffer.face, gbuffer.side, normals, corners, patch, sets, cull_faces, ids)
        for patch, sets in zip(patches, samples)
    ]
