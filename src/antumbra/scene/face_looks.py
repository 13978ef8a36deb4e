"""The looks of faces in their order, piece by piece, for stores: materials, and attributes of corners."""

from abc import ABC, abstractmethod
from collections.abc import Collection
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from .appearance import Appearance, appearance_of_piece
from .materials import Material, MeshAppearance, pbr_of
from .mesh import Piece
from .scene_bounds import faces_of
from .shared_vertices import SharedVertices, shares_vertices


class LookWidth(NamedTuple):
    """An attribute of faces: its numbers for each face, and the number where a face has none."""

    n: int
    default: float


LOOK_WIDTHS = {
    "uv": LookWidth(6, 0.0),
    "colours": LookWidth(12, 1.0),
    "normals": LookWidth(12, 0.0),
    "tangents": LookWidth(10, 0.0),
    "second_uv": LookWidth(6, 0.0),
}
"""The attributes of `FaceLooks`."""


def attributes_of(look: MeshAppearance) -> set[str]:
    """The attributes that faces with this look have."""
    found = {name for name in LOOK_WIDTHS if getattr(look, name) is not None} - {"tangents"}
    bumpy = look.uv is not None and any(pbr_of(each).normal_map is not None for each in look.materials)
    return found | ({"tangents"} if bumpy else set())


class FaceLooks(NamedTuple):
    """The looks of n consecutive faces. An attribute is None if no face has it."""

    kind: NDArray[
        np.int32
    ]  # (n,): twice the index of the material, plus 1 with texture coordinates; -1: a plain colour
    uv: NDArray[np.float32] | None = None  # (n, 6): texture coordinates of corners
    colours: NDArray[np.float32] | None = None  # (n, 12): colours and alphas of corners
    normals: NDArray[np.float32] | None = None  # (n, 12): `Appearance.normals`, then `bends`
    tangents: NDArray[np.float32] | None = None  # (n, 10): `Appearance.tangents`, then `hands`
    second_uv: NDArray[np.float32] | None = None  # (n, 6): a second set of texture coordinates

    def part(self, first: int, last: int) -> "FaceLooks":
        """Those of the faces `first` to `last`, exclusive."""
        kind, *columns = self
        return FaceLooks(kind[first:last], *(None if column is None else column[first:last] for column in columns))

    def numbered(self, numbers: NDArray[np.int32]) -> "FaceLooks":
        """The looks with other numbers for their materials; `numbers`: (m,), the new one of each material."""
        if not len(numbers):
            return self
        material = numbers[np.maximum(self.kind >> 1, 0)]
        return self._replace(kind=np.where(self.kind >= 0, 2 * material + (self.kind & 1), np.int32(-1)))


def plain_looks(n: int) -> FaceLooks:
    """The looks of faces with plain colours."""
    return FaceLooks(np.full(n, -1, np.int32))


def looks_of(appearance: Appearance) -> FaceLooks:
    """The looks of an appearance."""
    n, a = len(appearance.material_of_face), appearance
    mapped = a.textured if a.mapped is None else a.mapped
    kind = np.where(a.material_of_face >= 0, 2 * a.material_of_face + mapped, -1).astype(np.int32)
    rows = lambda array: None if array is None else array.reshape(n, -1)
    normals = None if a.normals is None or a.bends is None else np.hstack([a.normals.reshape(n, 9), a.bends])
    tangents = (
        None if a.tangents is None or a.hands is None else np.hstack([a.tangents.reshape(n, 9), a.hands[:, None]])
    )
    return FaceLooks(kind, rows(a.uv), rows(a.colours), normals, tangents, rows(a.second_uv))


class LookFinder(ABC):
    """Finds the looks of pieces, which are given in order.

    attributes : of faces, as far as they are known before
    """

    attributes: Collection[str]

    @property
    def face_bytes(self) -> int:
        """Bytes of the looks of a face, at most."""
        return 4 * (1 + sum(LOOK_WIDTHS[name].n for name in self.attributes))

    @abstractmethod
    def of(self, piece: Piece) -> tuple[FaceLooks, list[Material]]:
        """The looks of a piece's faces, copy by copy, and the materials that they index."""


class FoundLooks(LookFinder):
    """Those of a scene in memory."""

    def __init__(self, appearance: Appearance):
        self._looks, self._materials, self._first = looks_of(appearance), appearance.materials, 0
        self.attributes = [name for name in LOOK_WIDTHS if getattr(self._looks, name) is not None]

    def of(self, piece: Piece) -> tuple[FaceLooks, list[Material]]:
        first, self._first = self._first, self._first + len(piece.vertices) * faces_of(piece)
        return self._looks.part(first, self._first), self._materials


class StreamedLooks(LookFinder):
    """Those of a scene whose pieces are never all in memory.

    shared : of meshes that are read in several pieces, whose vertices at borders have faces of others; None: no mesh is
    """

    def __init__(self, attributes: Collection[str] = (), shared: SharedVertices | None = None):
        self.attributes, self._shared = attributes, shared

    def of(self, piece: Piece) -> tuple[FaceLooks, list[Material]]:
        shading = None if self._shared is None or not shares_vertices(piece) else self._shared.of(piece)
        appearance = appearance_of_piece(piece, shading)
        if appearance is None:
            return plain_looks(len(piece.vertices) * faces_of(piece)), []
        return looks_of(appearance), appearance.materials
