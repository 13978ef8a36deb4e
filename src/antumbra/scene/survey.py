"""The bounds of a scene, from its pieces one after the other."""

from collections.abc import Iterable

import numpy as np

from ..errors import InputError
from .recentre import MAX_EXTENT, MIN_EXTENT
from .source import Piece


def faces_of(piece: Piece) -> int:
    """The number of faces of each copy."""
    return piece.vertices.shape[1] // 3 if piece.faces is None else len(piece.faces)


def objects_of(pieces: Iterable[Piece]) -> np.ndarray:
    """(n,) int32: the object of each face of the pieces, in their order."""
    ids = [np.empty(0, np.int32)]
    for piece in pieces:
        if piece.owners is not None:
            ids.append(piece.owners)
            continue
        copies = np.arange(piece.first, piece.first + len(piece.vertices), dtype=np.int32)
        ids.append(np.repeat(copies, faces_of(piece)))
    return np.concatenate(ids)


def check_extent(bounds: np.ndarray, file: str) -> None:
    """Raise InputError if a scene with these bounds, (2, 3) float64, is too large or too small; `file` names it."""
    lower, upper = bounds
    if not (upper - lower <= MAX_EXTENT).all():
        raise InputError(
            f"{file}: the scene reaches from {lower.tolist()} to {upper.tolist()}; "
            f"it must be finite and at most {MAX_EXTENT:g} units wide"
        )
    extent = (upper - lower).max()
    if 0.0 < extent < MIN_EXTENT:
        raise InputError(
            f"{file}: the scene is {extent:.3g} units wide; float32 does not hold triangles of scenes below "
            f"{MIN_EXTENT:.2g} units: multiply all coordinates by a power of two"
        )


class Survey:
    """The number of triangles and the bounds of all added pieces; `file` names them in errors."""

    def __init__(self, file: str):
        self.file, self.n_triangles = file, 0
        self._lower, self._upper = np.full(3, np.inf), np.full(3, -np.inf)

    def add(self, piece: Piece) -> None:
        """Count a piece that does not move."""
        count = len(piece.vertices) * faces_of(piece)
        if count:
            self._lower = np.minimum(self._lower, piece.vertices.min(axis=(0, 1)))  # NaN stays, and fails in `bounds`
            self._upper = np.maximum(self._upper, piece.vertices.max(axis=(0, 1)))
        self.n_triangles += count

    def bounds(self) -> np.ndarray:
        """(2, 3) float64: lower and upper corner.

        Raises
        ------
        InputError
            If there are no triangles, or the scene is too large or too small.
        """
        if self.n_triangles == 0:
            raise InputError(f"{self.file}: no triangles; export the scene with its meshes triangulated")
        bounds = np.stack([self._lower, self._upper])
        check_extent(bounds, self.file)
        return bounds
