"""Rays from points on surfaces in cosine-weighted directions: the integrand of view factors, as a uniform sample.

A ray is a point of the four-dimensional unit cube: one coordinate chooses the face and, within it, the first of two
coordinates on the face; two more choose the direction. The points are a Sobol sequence, shifted digitally at random
for each replicate of each group [Owen 2023, ch. 17]. Their strata extend over
all faces of a group, by area. The spread of the replicates gives the standard error.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...kernels.elementary import sin_cos
from ...kernels.small_matrices import tangents_of
from ...query.receivers import SHIFT, point_receivers
from ...scene.triangles import Triangles
from ..sensors.surface_groups import unit_normals

REPLICATES = 8
"""Independent samples of each group, whose spread gives the error."""

_BITS = 32  # of a coordinate of a Sobol point
_SHIFTS = 4 * REPLICATES  # random numbers per group
_MARGIN = 8.0 * SHIFT  # distance of points from the edges of their face, relative to the coordinates


class SurfaceRays(NamedTuple):
    """Rays from groups of faces, in the order of groups, then replicates."""

    origins: NDArray[np.float64]  # (m, 3) world, moved off their faces
    directions: NDArray[np.float64]  # (m, 3) unit vectors
    faces: NDArray[np.int64]  # (m,) the face of each origin


class HemisphereRays:
    """Makes rays from groups of faces.

    triangles : Triangles
    of_face : (faces,) int
        The group of each face; -1: none. Each group has an area.
    samples : int
        Rays per group, a power of two, at least `REPLICATES`.
    sign : float
        1: rays leave the side from which corners run counterclockwise; -1: the other one.
    seed : int
    streams : (groups,) int, optional
        The number of each group's random stream, ascending; None: that of the group. States of a scene, some of whose
        faces are hidden, then have the same rays.
    """

    def __init__(
        self, triangles: Triangles, of_face: NDArray[np.integer], samples: int, sign: float, seed: int,
        streams: NDArray[np.integer] | None = None,
    ):  # fmt: skip
        corners = triangles.vertices.astype(np.float64)
        areas = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1) / 2.0
        self._corners, self._face_areas, self._origin = _shrunk(corners, areas), areas, triangles.origin
        self._samples, self._seed = samples, seed
        self.normals = sign * unit_normals(corners)
        self._tangents = tangents_of(self.normals)
        self._faces = np.argsort(of_face, kind="stable")[np.count_nonzero(of_face < 0) :]
        self._ends = np.cumsum(areas[self._faces])  # running area of the faces, by group
        counts = np.bincount(of_face[self._faces])
        self._last = np.cumsum(counts)
        self._first = self._last - counts
        self.areas = np.bincount(of_face[self._faces], areas[self._faces])
        self._streams = np.arange(len(counts)) if streams is None else streams
        self._points = _sobol_points(samples // REPLICATES)

    def of_groups(self, first: int, last: int) -> SurfaceRays:
        """The rays of the groups from `first` to `last`, exclusive."""
        groups = np.repeat(np.arange(first, last), self._samples)
        u = self._cube_points(first, last)
        faces, share = self._chosen_faces(groups, u[:, 0])
        places, normals = self._places(faces, share, u[:, 1]), self.normals[faces]
        directions = self._directions(faces, u[:, 2], u[:, 3])
        origins = point_receivers(places, normals, places, False).astype(np.float64) + self._origin
        return SurfaceRays(origins, directions, faces)

    def _cube_points(self, first: int, last: int) -> NDArray[np.float64]:
        """(groups * samples, 4) float64 in (0, 1)."""
        streams = self._streams[first:last]
        generator = np.random.Philox(key=self._seed)
        generator.advance(int(streams[0]) * _SHIFTS // 8)  # it counts blocks of eight 32-bit numbers
        raw = generator.random_raw(int(streams[-1] + 1 - streams[0]) * _SHIFTS // 2)
        shifts = raw.view(np.uint32).reshape(-1, REPLICATES, 1, 4)[streams - streams[0]]
        return np.asarray(((self._points ^ shifts) + 0.5) / 2.0**_BITS, np.float64).reshape(-1, 4)

    def _chosen_faces(
        self, groups: NDArray[np.int64], u: NDArray[np.float64]
    ) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
        """Faces of groups in proportion to their areas, and the place of each `u` within the share of its face."""
        begin = np.where(self._first[groups] > 0, self._ends[self._first[groups] - 1], 0.0)
        target = begin + u * (self._ends[self._last[groups] - 1] - begin)
        at = np.clip(np.searchsorted(self._ends, target, "right"), self._first[groups], self._last[groups] - 1)
        faces = self._faces[at]
        areas = self._face_areas[faces]
        share = 1.0 - np.divide(self._ends[at] - target, areas, out=np.full_like(areas, 0.5), where=areas > 0.0)
        return faces, np.clip(share, 0.0, 1.0)

    def _places(self, faces: NDArray[np.int64], u: NDArray[np.float64], v: NDArray[np.float64]) -> NDArray[np.float64]:
        """(m, 3) float64, recentred: uniformly distributed points on faces."""
        root = np.sqrt(u)
        weights = np.stack([1.0 - root, root * (1.0 - v), root * v], 1)
        return np.asarray(np.einsum("ij,ijk->ik", weights, self._corners[faces]))

    def _directions(
        self, faces: NDArray[np.int64], u: NDArray[np.float64], v: NDArray[np.float64]
    ) -> NDArray[np.float64]:
        """(m, 3) float64: unit vectors, distributed as the cosine to the normals of faces."""
        radius, height = np.sqrt(u), np.sqrt(1.0 - u)
        sine, cosine = sin_cos(2.0 * np.pi * v)
        across, along = (tangents[faces] for tangents in self._tangents)
        across *= (radius * cosine)[:, None]
        along *= (radius * sine)[:, None]
        return np.asarray(across + along + height[:, None] * self.normals[faces])


def _shrunk(corners: NDArray[np.float64], areas: NDArray[np.float64]) -> NDArray[np.float64]:
    """(n, 3, 3) float64: faces shrunk by a few units in the last place, towards the centres of their inscribed circles.

    So neither rounding nor the offset from the face puts a point behind a neighbouring face.
    """
    edges = np.linalg.norm(np.roll(corners, -1, 1) - corners, axis=2)
    opposite, perimeters = np.roll(edges, -1, 1), np.maximum(edges.sum(1), np.finfo(np.float64).tiny)
    centres = np.einsum("ij,ijk->ik", opposite, corners) / perimeters[:, None]
    radii = np.maximum(2.0 * areas / perimeters, np.finfo(np.float64).tiny)
    shares = np.minimum(_MARGIN * np.abs(corners).max((1, 2)) / radii, 0.5)[:, None, None]
    return np.asarray(corners + shares * (centres[:, None] - corners))


def _sobol_points(count: int) -> NDArray[np.uint32]:
    """(count, 4) uint32: the first points of a Sobol sequence, as fixed-point numbers."""
    from scipy.stats.qmc import Sobol

    return np.asarray(Sobol(4, scramble=False, bits=_BITS).random(count) * 2.0**_BITS).astype(np.uint32)
