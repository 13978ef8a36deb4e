"""Small images of a scene, from which its default view follows."""

from collections.abc import Sequence
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from ..query.query_bounds import bounds
from ..query.shadow_query import Surfaces
from ..scene.camera import Camera
from ..scene.triangles import Triangles
from .primary_visibility import primary_visibility


class SceneViews(Protocol):
    """Makes images of a scene at time 0, by perspective cameras.

    box : (2, 3) float32
        Bounds of the scene in its recentred frame.
    origin : (3,) float64
        World position of the frame's origin.
    """

    @property
    def box(self) -> NDArray[np.float32]: ...

    @property
    def origin(self) -> NDArray[np.float64]: ...

    def see(self, camera: Camera) -> Surfaces:
        """The surfaces visible to a camera."""
        ...

    def see_solid(self, camera: Camera) -> Surfaces:
        """The visible surfaces of the solid faces alone, without those that let light pass."""
        ...

    def triangles(self) -> Triangles | None:
        """All triangles; None if they do not fit in memory."""
        ...

    def end(self) -> None:
        """Free the memory that only images need."""


class ViewsInMemory:
    """`SceneViews` of triangles in memory, rasterised."""

    def __init__(self, triangles: Triangles, threads: int | None = None) -> None:
        self._triangles, self._threads = triangles, threads
        self.box: NDArray[np.float32] = np.stack(bounds(triangles.vertices, threads))
        self.origin = triangles.origin

    def see(self, camera: Camera) -> Surfaces:
        return self._rasterised(self._triangles, camera)

    def see_solid(self, camera: Camera) -> Surfaces:
        return self._rasterised(self._triangles._replace(cutouts=None), camera)

    def triangles(self) -> Triangles:
        return self._triangles

    def end(self) -> None:
        """No-op: all triangles stay in memory."""

    def _rasterised(self, triangles: Triangles, camera: Camera) -> Surfaces:
        gbuffer = primary_visibility(triangles, camera, None, self._threads)
        face = gbuffer.face
        return Surfaces(gbuffer, triangles, np.where(face >= 0, triangles.face_id[face], np.int32(-1)))


def corners_seen(images: Sequence[Surfaces]) -> NDArray[np.float32]:
    """(m, 3, 3) float32, recentred: the corners of each face that images show, in the order of faces."""
    corners, ids = list[NDArray[np.float32]](), list[NDArray[np.integer]]()
    for image in images:
        rows, pixels = np.unique(image.gbuffer.face, return_index=True)
        pixels = pixels[rows >= 0]
        corners.append(image.triangles.vertices[rows[rows >= 0]])
        ids.append(image.ids.reshape(-1)[pixels])
    return np.concatenate(corners)[np.unique(np.concatenate(ids), return_index=True)[1]]
