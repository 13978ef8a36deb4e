"""What a picture asks: the shadow queries of the surfaces that its pixels see."""

import numpy as np

from ..scene.lights import AMBIENT
from .reach import reach
from .receivers import surface_receivers
from .shadow import ShadowQuery


def shadow_queries(triangles, gbuffer, lights, samples, cull_faces=0, threads=None) -> list[ShadowQuery]:
    """The query of each light for the surfaces in a G-buffer; ``samples``: of each light from `light_samples`."""
    shape = gbuffer.face.shape
    corners = triangles.vertices.reshape(-1, 9)
    flat = (
        gbuffer.position.reshape(-1, 3),
        gbuffer.normal.reshape(-1, 3),
        gbuffer.face.reshape(-1),
        gbuffer.side.reshape(-1),
    )
    origins = surface_receivers(*flat, corners, threads).reshape(*shape, 3)
    far = reach(triangles, gbuffer.position, threads) if triangles.vertices.size else 1.0
    patches = [light.patch(triangles.origin, far) for light in lights]
    ambient = any(p.kind == AMBIENT for p in patches)
    normals = gbuffer.normal.astype(np.float64) if ambient else np.empty((0, 0, 3))
    return [
        ShadowQuery(origins, gbuffer.face, gbuffer.side, normals, corners, patch, sets, cull_faces, gbuffer.face)
        for patch, sets in zip(patches, samples)
    ]
