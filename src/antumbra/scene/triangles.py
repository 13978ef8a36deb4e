"""`Triangles`, the geometry of a scene at one moment; `Hit`, nearest hits of rays; `AllHits`; and `ClosestPoints`.

A `Hit` holds distances, faces and barycentric coordinates. Positions, normals and corners are computed on demand from
the triangles that were hit.
"""

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..base.errors import InputError
from ..base.wording import counted
from .alpha_masks import Cutouts

# --- Triangles --------------------------------------------------------------------------------------------------------


class Triangles(NamedTuple):
    """A triangle soup in the recentred frame of its scene. World position = vertices + origin.

    Examples
    --------
    >>> triangles = at.examples.temple().triangles()
    >>> world = triangles.vertices + triangles.origin
    >>> world.shape
    (51784, 3, 3)
    """

    vertices: NDArray[np.float32]  # (n, 3, 3) float32, recentred frame, C-contiguous
    origin: NDArray[np.float64]  # (3,) float64, world position of the frame's origin
    face_id: NDArray[np.int32]  # (n,) int32, index of the face in the scene; the same at every time
    colour: NDArray[np.float32]  # (n, 3) float32, linear base colour in [0, 1]
    cutouts: Cutouts | None = None  # alpha-masked faces; None: all faces are solid
    solid: NDArray[np.int32] | None = None  # (k,) int32, ascending: rows with area and without holes; None: all

    def __repr__(self) -> str:
        return f"Triangles({counted(len(self.vertices), 'triangle')}; {', '.join(self._fields)})"


def concatenate(soups: Sequence[Triangles]) -> Triangles:
    """Several triangle soups in the same frame as one."""
    if len(soups) == 1:
        return soups[0]
    vertices, ids, colour = (
        np.concatenate([getattr(each, name) for each in soups]) for name in ("vertices", "face_id", "colour")
    )
    return Triangles(vertices, soups[0].origin, ids, colour)


# --- Closest hits -----------------------------------------------------------------------------------------------------


class HitFilter(NamedTuple):
    """The hits of rays that count, unchecked. `Scene.occluded` documents the fields."""

    tmin: ArrayLike = 0.0
    tmax: ArrayLike = np.inf
    skip_face: ArrayLike | None = None
    cull_faces: str | None = None


class HitFaces(NamedTuple):
    """The arrays of a `Hit`."""

    t: NDArray[np.float64]  # (...) float64, in lengths of the direction, rounded to nearest; inf on a miss, NaN: failed
    face: NDArray[np.int32]  # (...) int32, index of the face in the scene; -1 on a miss; int64: tiles beyond int32
    u: NDArray[np.float32]  # (...) float32, barycentric weight of the face's second corner, 0 to 1; 0 on a miss
    v: NDArray[np.float32]  # (...) float32, barycentric weight of its third corner, 0 to 1; 0 on a miss


class Hit(HitFaces):
    """Closest hits of rays: a tuple (t, face, u, v) with the rays' leading shape (...).

    The first use of `position`, `normal` or `corners` fetches the triangles that were hit. They are not available
    after unpickling.

    Examples
    --------
    >>> hit = at.examples.temple().closest_hit([[0, 20, 14], [0, 20, 0]], (0, -1, 0))
    >>> hit.t.round(2), hit.mask
    (array([ inf, 8.25]), array([False,  True]))
    """

    _find: Callable[[], tuple[Triangles, np.ndarray]] | None = None
    _object_of_face: Callable[[], np.ndarray] | None = None

    @classmethod
    def of_scene(
        cls, faces: HitFaces, find: Callable[[], tuple[Triangles, np.ndarray]], object_of_face: Callable[[], np.ndarray]
    ) -> "Hit":
        """A `Hit` with access to its triangles and objects; `surfaces` calls `find()` at most once."""
        hit = cls._make(faces)
        hit._find, hit._object_of_face = find, object_of_face
        return hit

    def surfaces(self) -> tuple[Triangles, np.ndarray]:
        """Triangles that include all that were hit; and (...) int: the index of each ray's triangle in them, or -1."""
        if self._find is None:
            raise _refusal()
        if not hasattr(self, "_surfaces"):
            self._surfaces = self._find()
        return self._surfaces

    @property
    def mask(self) -> NDArray[np.bool_]:
        """(...) bool: whether the ray hits a face."""
        return self.face >= 0

    @property
    def position(self) -> NDArray[np.float64]:
        """(..., 3) float64, world: the hit point on the face; NaN on a miss."""
        a, b, c = self._corners_of_hits().swapaxes(0, 1)
        u, v = (w[self.mask].astype(np.float64)[:, None] for w in (self.u, self.v))
        return self._per_ray(a + u * (b - a) + v * (c - a))

    @property
    def normal(self) -> NDArray[np.float64]:
        """(..., 3) float64: the unit face normal, oriented by the winding order; NaN on a miss.

        The corners are counter-clockwise seen from the side to which the normal points. The ray may come from either
        side.
        """
        a, b, c = self._corners_of_hits().swapaxes(0, 1)
        normals = np.cross(b - a, c - a)
        return self._per_ray(normals / np.linalg.norm(normals, axis=1, keepdims=True))

    @property
    def corners(self) -> NDArray[np.float64]:
        """(..., 3, 3) float64, world: the three corners of the face; NaN on a miss."""
        out = np.full((*self.face.shape, 3, 3), np.nan)
        out[self.mask] = self._corners_of_hits()
        return out

    @property
    def object(self) -> NDArray[np.int32]:
        """(...) int32: index in `Scene.objects` of the object that was hit; -1 on a miss."""
        if self._object_of_face is None:
            raise _refusal()
        objects = np.full(self.face.shape, -1, np.int32)
        objects[self.mask] = self._object_of_face()[self.face[self.mask]]
        return objects

    def _corners_of_hits(self) -> NDArray[np.float64]:
        """(m, 3, 3) float64, world: the face corners of all rays that hit."""
        triangles, index = self.surfaces()
        out: NDArray[np.float64] = triangles.vertices[index[index >= 0]].astype(np.float64) + triangles.origin
        return out

    def _per_ray(self, values: np.ndarray) -> np.ndarray:
        out = np.full((*self.face.shape, 3), np.nan)
        out[self.mask] = values
        return out

    def __getstate__(self) -> None:
        return None  # a pickle holds the arrays only

    def __repr__(self) -> str:
        return f"Hit({self.face.shape} rays, {int(self.mask.sum())} of them hit a face; t, face, u, v)"


def _refusal() -> InputError:
    return InputError("this Hit has no scene, since it was pickled or built by hand; call scene.closest_hit again")


# --- All hits ---------------------------------------------------------------------------------------------------------


class AllHits(NamedTuple):
    """All hits of n rays: those of ray i are elements ``ray_offsets[i]`` to ``ray_offsets[i + 1] - 1``, sorted by t.

    Of hits with the same t, those on the fronts of faces come first; then they are sorted by face.
    """

    ray_offsets: NDArray[np.int64]  # (n + 1,) int64
    t: NDArray[np.float64]  # (k,) float64, in lengths of the direction, rounded to nearest
    face: NDArray[np.int32]  # (k,) int32, index of the face in the scene; int64: tiles beyond int32
    u: NDArray[np.float32]  # (k,) float32, barycentric weight of the face's second corner, 0 to 1
    v: NDArray[np.float32]  # (k,) float32, barycentric weight of its third corner, 0 to 1

    @property
    def counts(self) -> NDArray[np.int64]:
        """(n,) int64: the number of hits of each ray."""
        return np.diff(self.ray_offsets)

    @property
    def ray(self) -> NDArray[np.int64]:
        """(k,) int64: the index of each hit's ray."""
        return np.repeat(np.arange(len(self.ray_offsets) - 1), self.counts)

    def __repr__(self) -> str:
        rays = counted(len(self.ray_offsets) - 1, "ray")
        return f"AllHits({counted(len(self.t), 'hit')} of {rays}; {', '.join(self._fields)})"


# --- Closest points ---------------------------------------------------------------------------------------------------


class ClosestPoints(NamedTuple):
    """The closest points of a scene's faces to points of shape (..., 3)."""

    distance: NDArray[np.float64]  # (...) float64; inf in a scene without faces, NaN: failed
    face: NDArray[np.int32]  # (...) int32, index of the face in the scene; -1 where there is none
    u: NDArray[np.float32]  # (...) float32, barycentric weight of the face's second corner, 0 to 1
    v: NDArray[np.float32]  # (...) float32, barycentric weight of its third corner, 0 to 1
    position: NDArray[np.float64]  # (..., 3) float64, world: the closest point; NaN where there is none

    def __repr__(self) -> str:
        return f"ClosestPoints({self.face.shape} points; {', '.join(self._fields)})"
