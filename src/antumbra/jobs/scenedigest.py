"""A digest of a scene, by which jobs know that kept results belong to it."""

import hashlib

import numpy as np

from ..engine.paged_scene import PagedScene
from ..engine.scene import AnyScene

_STORE_HEADER = 4096  # bytes of a store, which hold the checksum of the checksums of all chunks


def scene_digest(scene: AnyScene, time: float, threads: int | None = None) -> str:
    """SHA-256 of the scene's triangles at a time, with colours, cut-outs and objects; of a store, of its first page."""
    digest = hashlib.sha256()
    if isinstance(scene, PagedScene):
        with scene.store.path.open("rb") as stream:
            digest.update(stream.read(_STORE_HEADER))
        return digest.hexdigest()
    triangles = scene.triangles(time, threads)
    arrays = triangles.vertices, triangles.origin, triangles.colour, scene.object_of_face
    for array in *arrays, *(triangles.cutouts or ()):
        digest.update(np.ascontiguousarray(array).data)
    return digest.hexdigest()
