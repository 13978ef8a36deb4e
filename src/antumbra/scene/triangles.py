"""The triangles of a scene at one moment, and `Hit`, the result of a closest-hit query on them."""

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np

from ..errors import InputError
from .alpha_masks import Cutouts

# --- Triangles: a scene at one moment, ready for kernels --------------------------------------------------------------


class Triangles(NamedTuple):
    """A triangle soup in the recentred frame of its scene. World position = vertices + origin."""

    vertices: np.ndarray  # (n, 3, 3) float32, recentred frame, C-contiguous
    origin: np.ndarray  # (3,) float64, world position of the frame's zero
    face_id: np.ndarray  # (n,) int32, index of the face in the scene; the same at every time
    colour: np.ndarray  # (n, 3) float32, linear base colour in [0, 1]
    cutouts: Cutouts | None = None  # faces with holes, and those without; None: all faces are solid
    solid: np.ndarray | None = None  # (k,) int32, ascending: rows with an area and without a hole; None: all rows

    def __repr__(self) -> str:
        return f"Triangles({len(self.vertices)} triangles; {', '.join(self._fields)})"


def concatenate(several: Sequence[Triangles]) -> Triangles:
    """Several soups of the same frame as one."""
    if len(several) == 1:
        return several[0]
    vertices, ids, colour = (
        np.concatenate([getattr(each, name) for each in several]) for name in ("vertices", "face_id", "colour")
    )
    return Triangles(vertices, several[0].origin, ids, colour)


# --- The answer to closest-hit rays -----------------------------------------------------------------------------------


class HitFaces(NamedTuple):
    """The arrays of a `Hit`."""

    t: np.ndarray  # (...) float64, in lengths of the direction, rounded to nearest; inf on a miss
    face: np.ndarray  # (...) int32, index of the face in the scene; -1 on a miss
    u: np.ndarray  # (...) float32, weight of the face's second corner, from 0 to 1; 0 on a miss
    v: np.ndarray  # (...) float32, weight of its third corner, from 0 to 1; 0 on a miss


class Hit(HitFaces):
    """Nearest hits of rays; leading shape (...) as the rays had. It is a tuple (t, face, u, v).

    The first use of `position`, `normal` and `corners` fetches the triangles that were hit. A `Hit` that was pickled
    has none of them.
    """

    _find: Callable[[], tuple[Triangles, np.ndarray]] | None = None
    _object_of_face: Callable[[], np.ndarray] | None = None

    @classmethod
    def of_scene(cls, faces: HitFaces, find: Callable, object_of_face: Callable) -> "Hit":
        """A `Hit` that can find its triangles and objects; `find()` is called for `surfaces`, at most once."""
        made = cls(*faces)
        made._find, made._object_of_face = find, object_of_face
        return made

    def surfaces(self) -> tuple[Triangles, np.ndarray]:
        """The triangles that were hit, and others; and (...) int: the index of each ray's triangle in them, or -1."""
        if self._find is None:
            raise _refusal()
        if not hasattr(self, "_kept"):
            self._kept = self._find()
        return self._kept

    @property
    def mask(self) -> np.ndarray:
        """(...) bool: whether the ray hits a face."""
        return self.face >= 0

    @property
    def position(self) -> np.ndarray:
        """(..., 3) float64, world: the point of the face that the ray meets; NaN on a miss."""
        a, b, c = self._corners_of_hits().swapaxes(0, 1)
        u, v = (w[self.mask].astype(np.float64)[:, None] for w in (self.u, self.v))
        return self._spread(a + u * (b - a) + v * (c - a))

    @property
    def normal(self) -> np.ndarray:
        """(..., 3) float64 of unit length: the normal of the face, by the order of its corners; NaN on a miss.

        The corners are counter-clockwise for those who look against it. The ray may come from either side.
        """
        a, b, c = self._corners_of_hits().swapaxes(0, 1)
        normals = np.cross(b - a, c - a)
        return self._spread(normals / np.linalg.norm(normals, axis=1, keepdims=True))

    @property
    def corners(self) -> np.ndarray:
        """(..., 3, 3) float64, world: the three corners of the face; NaN on a miss."""
        out = np.full((*self.face.shape, 3, 3), np.nan)
        out[self.mask] = self._corners_of_hits()
        return out

    @property
    def object(self) -> np.ndarray:
        """(...) int32: index in `Scene.objects` of the object that the ray meets; -1 on a miss."""
        if self._object_of_face is None:
            raise _refusal()
        found = np.full(self.face.shape, -1, np.int32)
        found[self.mask] = self._object_of_face()[self.face[self.mask]]
        return found

    def _corners_of_hits(self) -> np.ndarray:
        """(m, 3, 3) float64, world: the corners of the faces of hits."""
        triangles, index = self.surfaces()
        return triangles.vertices[index[index >= 0]].astype(np.float64) + triangles.origin

    def _spread(self, values: np.ndarray) -> np.ndarray:
        out = np.full((*self.face.shape, 3), np.nan)
        out[self.mask] = values
        return out

    def __getstate__(self) -> None:
        return None  # a pickle has the arrays only

    def __repr__(self) -> str:
        return f"Hit({self.face.shape} rays, {int(self.mask.sum())} of them hit a face; t, face, u, v)"


def _refusal() -> InputError:
    return InputError("this Hit has no scene, since it was pickled or built by hand; ask scene.closest_hit again")
