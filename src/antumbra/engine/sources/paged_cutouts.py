"""The cut-outs of a store in memory, and hits on solid triangles with nearer ones on cut-outs."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...query.ray_list import HitArrays
from ...scene.triangles import Triangles, concatenate
from ...store.stored_cutouts import StoredCutouts
from ...trace.alpha_cutouts import SolidHits, add_nearest, tree_of_cutouts
from ...trace.rays.local_rays import LocalRays
from .cutout_hits import CutoutHits


class TracedHits(NamedTuple):
    """The hits of n rays, and the triangles hit."""

    face: NDArray[np.int32]  # (n,), -1 on a miss
    t: NDArray[np.float64]  # (n,)
    row: NDArray[np.int32]  # (n,): of the triangle hit, or -1
    triangles: Triangles  # at least one


class PagedCutouts:
    """The cut-outs of a store, which stay in memory, unlike its chunks."""

    def __init__(self, stored: StoredCutouts, origin: NDArray[np.float64], threads: int):
        self._stored, self._origin = stored, origin
        corners = stored.corners.reshape(-1, 3, 3)
        self.tree = tree_of_cutouts(stored.cutouts, corners, np.zeros((1, 9), np.float32), threads)
        self.hits = CutoutHits(self.tree, threads)

    def show(self, rays: LocalRays, hits: TracedHits, threads: int) -> TracedHits:
        """Hits, with those on cut-outs where they are nearer."""
        face, t, row = hits.face.copy(), hits.t.copy(), hits.row.copy()
        u, v = np.empty(len(face), np.float32), np.empty(len(face), np.float32)
        solid = SolidHits(hits.triangles.vertices.reshape(-1, 9), hits.row)
        add_nearest(self.tree, rays, HitArrays(np.empty(0, np.bool_), face, t, u, v), threads, solid)
        nearer = face != hits.face
        if not nearer.any():
            return hits
        faces, place = np.unique(face[nearer], return_inverse=True)
        row[nearer] = len(hits.triangles.vertices) + place
        return TracedHits(face, t, row, concatenate([hits.triangles, self._triangles(faces)]))

    def _triangles(self, faces: NDArray[np.int32]) -> Triangles:
        at = np.searchsorted(self._stored.cutouts.faces, faces)
        corners = self._stored.corners[at].reshape(-1, 3, 3)
        return Triangles(corners, self._origin, faces, self._stored.colours[at])
