"""The faces of pieces that are not solid, for stores, which read scenes piece by piece."""

from abc import ABC, abstractmethod
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from .alpha_masks import CUT, SOLID, Cutouts, FaceMasks, TexelMask, finite_uv, kinds_of, masks_in, texel_mask
from .appearance import appearance_of_mesh
from .mesh import Piece
from .scene_bounds import faces_of

CLEAR, HIDDEN = -1, -2
"""In place of the mask of a face that no ray hits, or that is not there."""


class OpenFaces(NamedTuple):
    """The faces of a piece that are not solid, copy by copy."""

    faces: NDArray[np.int32]  # (m,) int32, ascending: numbers in the piece
    mask: NDArray[np.int32]  # (m,) int32: index of the mask of a cut-out; or CLEAR or HIDDEN
    uv: NDArray[np.float32]  # (m, 3, 2) float32: texture coordinates of their corners

    def part(self, first: int, last: int) -> "OpenFaces":
        """Those of the faces `first` to `last`, exclusive, which are numbered from 0 on."""
        begin, end = np.searchsorted(self.faces, [first, last])
        return OpenFaces(self.faces[begin:end] - np.int32(first), self.mask[begin:end], self.uv[begin:end])

    def with_masks_from(self, first: int) -> "OpenFaces":
        """The faces with masks that follow `first` others."""
        return self._replace(mask=np.where(self.mask >= 0, self.mask + np.int32(first), self.mask))


NONE_OPEN = OpenFaces(np.empty(0, np.int32), np.empty(0, np.int32), np.empty((0, 3, 2), np.float32))
"""All faces are solid."""


class OpenFaceFinder(ABC):
    """Finds the faces of pieces that are not solid. The pieces are given in order."""

    @abstractmethod
    def of(self, piece: Piece) -> OpenFaces: ...

    @property
    @abstractmethod
    def masks(self) -> list[TexelMask]:
        """The masks of the pieces so far, to which further pieces may add."""


class FoundOpenFaces(OpenFaceFinder):
    """Those of a scene in memory.

    n : number of faces
    cutouts : None: all faces are solid
    hidden : (n,) bool: faces that are not there; None: none
    """

    def __init__(self, n: int, cutouts: Cutouts | None, hidden: NDArray[np.bool_] | None):
        is_open = np.zeros(n, np.bool_)
        if cutouts is not None:
            is_open[:] = True
            is_open[cutouts.solid] = False
        if hidden is not None:
            is_open |= hidden
        self._cutouts, self._hidden, self._first = cutouts, hidden, 0
        self._open = np.flatnonzero(is_open)

    def of(self, piece: Piece) -> OpenFaces:
        first, self._first = self._first, self._first + len(piece.vertices) * faces_of(piece)
        faces = self._open[slice(*np.searchsorted(self._open, [first, self._first]))]
        mask, uv = np.full(len(faces), CLEAR, np.int32), np.zeros((len(faces), 3, 2), np.float32)
        if self._cutouts is not None and len(self._cutouts.faces):
            at = np.minimum(np.searchsorted(self._cutouts.faces, faces), len(self._cutouts.faces) - 1)
            cut = self._cutouts.faces[at] == faces
            mask[cut], uv[cut] = self._cutouts.mask[at[cut]], self._cutouts.uv[at[cut]]
        if self._hidden is not None:
            mask[self._hidden[faces]] = HIDDEN
        return OpenFaces((faces - first).astype(np.int32), mask, uv)

    @property
    def masks(self) -> list[TexelMask]:
        return [] if self._cutouts is None else masks_in(self._cutouts)


class StreamedOpenFaces(OpenFaceFinder):
    """Those of a scene whose pieces are never all in memory. Before, `count` has been called with each of them."""

    def __init__(self) -> None:
        self._found = FaceMasks()

    def count(self, piece: Piece) -> None:
        """Count the masks that a piece may need."""
        if _lets_light_pass(piece):
            assert piece.look is not None
            self._found.count(appearance_of_mesh(piece.look, _corners_of(piece)))

    def of(self, piece: Piece) -> OpenFaces:
        if not _lets_light_pass(piece):
            return NONE_OPEN
        assert piece.look is not None
        appearance = appearance_of_mesh(piece.look, _corners_of(piece))
        mask = self._found.find(appearance)
        uv = np.zeros((len(mask), 3, 2), np.float32) if appearance.uv is None else appearance.uv
        kinds = kinds_of(uv, mask, self._found.masks)
        faces, copies = np.flatnonzero(kinds != SOLID), len(piece.vertices)
        mask = np.where(kinds[faces] == CUT, mask[faces], CLEAR).astype(np.int32)
        uv = np.where((mask >= 0)[:, None, None], finite_uv(uv[faces]), np.float32(0.0))
        numbers = faces + len(kinds) * np.arange(copies)[:, None]
        return OpenFaces(numbers.reshape(-1).astype(np.int32), np.tile(mask, copies), np.tile(uv, (copies, 1, 1)))

    @property
    def masks(self) -> list[TexelMask]:
        return [texel_mask(each) for each in self._found.masks]


def _lets_light_pass(piece: Piece) -> bool:
    return piece.look is not None and any(material.lets_light_pass for material in piece.look.materials)


def _corners_of(piece: Piece) -> NDArray[np.integer]:
    """(f, 3): the faces of a piece."""
    return np.arange(3 * faces_of(piece)).reshape(-1, 3) if piece.faces is None else piece.faces
