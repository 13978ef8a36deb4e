"""Triangles by indexed vertices: their corners are gathered, and those without area found, when they are first read.

The tree of ray lists is refitted from the vertices and faces themselves, so a scene that moves between ray lists never
writes the corners in the order of its faces.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..base.fetched_fields import FetchedFields
from ..kernels.array_pool import ArrayPool
from .triangle_setup import gather_faces, rows_with_area, solid_faces
from .triangles import Triangles


class IndexedVertices(NamedTuple):
    """Vertices in the frame of a scene, and its faces."""

    positions: NDArray[np.float32]  # (v, 3) float32, as from `padded_rows`
    faces: NDArray[np.int32] | None  # (n, 3) int32, vertices of each face; None: 0, 1, 2; 3, 4, 5; and so on


def padded_rows(n: int, pool: ArrayPool) -> NDArray[np.float32]:
    """(n, 3) float32, uninitialised, in recycled memory. The memory of one more number follows the last row."""
    rows: NDArray[np.float32] = pool.empty((3 * n + 1,), np.float32)[:-1].reshape(n, 3)
    return rows


class IndexedTriangles(FetchedFields, Triangles):
    """Triangles by indexed vertices. `vertices` and `solid` are found when they are first read, and kept.

    indexed : IndexedVertices
    """

    _plain = Triangles
    indexed: IndexedVertices
    _solid: NDArray[np.int32] | None
    _pool: ArrayPool
    _threads: int

    @classmethod
    def of(cls, indexed: IndexedVertices, triangles: Triangles, pool: ArrayPool, threads: int) -> "IndexedTriangles":
        """Triangles with these vertices, and everything else of `triangles`.

        pool : from which the corners get their memory
        threads : which gather them
        """
        new = cls._make(triangles)
        new.indexed, new._pool, new._threads = indexed, pool, threads
        return new

    @property
    def vertices(self) -> NDArray[np.float32]:
        if "_corners" not in vars(self):
            self._find()
        return self._corners

    @property
    def solid(self) -> NDArray[np.int32] | None:
        if "_solid" not in vars(self):
            self._find()
        return self._solid

    def mark_solid(self) -> None:
        """Record that all triangles have an area and none has holes, as a refit has found."""
        self._solid = None

    def _find(self) -> None:
        (positions, faces), n = self.indexed, len(self.face_id)
        if faces is None:
            corners = positions.reshape(n, 3, 3)
            with_area = rows_with_area(corners, self._threads)
        else:
            corners = padded_rows(3 * n, self._pool).reshape(n, 3, 3)
            with_area = gather_faces(positions, faces, corners, self._threads)
        self._solid = solid_faces(with_area, None if self.cutouts is None else self.cutouts.solid)
        self._corners: NDArray[np.float32] = corners  # last: other threads may look for it
