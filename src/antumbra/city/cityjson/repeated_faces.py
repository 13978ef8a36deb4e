"""Faces that a file lists more than once; areas, energy and counts would include each copy."""

from collections.abc import Callable, Iterable
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ...base.wording import counted
from ...scene.mesh import Mesh, Piece

_FILE_BITS = 4  # of a code, which choose its scratch file

_MIX = np.uint64(0x9E3779B97F4A7C15)  # 2^64 divided by the golden ratio, odd: multiplying by it permutes uint64


def repeated_faces_notes(mesh: Mesh, file: str) -> list[str]:
    """A note with the number of faces that lie on others, with the same corners and facing the same way; [] if none.

    Pairs that face opposite ways, such as walls between two buildings, do not count.
    """
    return repeats_notes(repeated_faces(mesh), file)


def repeats_notes(count: int, file: str) -> list[str]:
    """The note of `repeated_faces_notes`, from the number of faces."""
    return (
        [f"{file}: {counted(count, 'triangle', 'repeat')} others; areas and energy count them again"] if count else []
    )


def repeated_faces(mesh: Mesh) -> int:
    """The number of faces with the corners of another one, in the same sense of rotation, all three different."""
    codes = _codes(mesh.positions, mesh.faces)
    if len(np.unique(codes)) == len(codes):  # the usual case, without slow comparisons
        return 0
    return _compared(mesh.positions, mesh.faces)


def _compared(positions: np.ndarray, faces: np.ndarray | None) -> int:
    _, place = np.unique(positions, axis=0, return_inverse=True)
    faces = place.reshape(-1, 3) if faces is None else place.reshape(-1)[faces]
    faces = faces[(faces != np.roll(faces, 1, axis=1)).all(1)]
    return len(faces) - len(np.unique(_turned(faces), axis=0))


def _codes(positions: np.ndarray, faces: np.ndarray | None) -> NDArray[np.uint64]:
    """(f,) uint64: equal for faces with the same corners in the same sense of rotation."""
    words = (positions.astype(np.float64) + 0.0).view(np.uint64)  # 0.0: -0.0 is 0.0
    code = _hashed(words)
    return _hashed(_turned(code.reshape(-1, 3) if faces is None else code[faces]))


def _repeated(codes: NDArray[np.uint64]) -> NDArray[np.uint64]:
    """The codes that are there more than once, ascending."""
    codes.sort()
    return np.unique(codes[1:][codes[1:] == codes[:-1]])


class StreamedRepeats:
    """The number of repeated faces of pieces that are never in memory all at once.

    folder : of scratch files, which hold 8 bytes per face
    """

    def __init__(self, folder: Path):
        self._files = [folder / f"codes {k}" for k in range(1 << _FILE_BITS)]

    def add(self, mesh: Mesh) -> None:
        codes = np.sort(_codes(mesh.positions, mesh.faces))
        ends = np.searchsorted(codes >> np.uint64(64 - _FILE_BITS), np.arange(len(self._files) + 1))
        for path, first, last in zip(self._files, ends, ends[1:]):
            with path.open("ab") as stream:
                stream.write(codes[first:last].data)

    def count(self, pieces: Callable[[], Iterable[Piece]]) -> int:
        """`repeated_faces` of all that was added; `pieces`: again."""
        again = np.concatenate([_repeated(np.fromfile(path, np.uint64)) for path in self._files])
        if not len(again):
            return 0
        corners = list[np.ndarray]()
        for piece in pieces():
            positions, faces = piece.vertices[0], piece.faces
            assert faces is not None
            place = np.minimum(np.searchsorted(again, codes := _codes(positions, faces)), len(again) - 1)
            corners.append(positions[faces[again[place] == codes]].reshape(-1, 3))
        return _compared(np.concatenate(corners), None)


def _turned(faces: np.ndarray) -> np.ndarray:
    """(f, 3): the corners of faces, each face beginning with its least one."""
    return np.take_along_axis(faces, (faces.argmin(1)[:, None] + np.arange(3)) % 3, 1)


def _hashed(words: NDArray[np.uint64]) -> NDArray[np.uint64]:
    """(n,) uint64: equal for equal rows, (n, 3)."""
    code = np.zeros(len(words), np.uint64)
    for column in words.T:
        code = (code ^ column) * _MIX
        code ^= code >> np.uint64(29)
    return code
