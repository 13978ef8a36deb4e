"""Faces that a file lists more than once; areas, energy and counts would include each copy."""

import numpy as np
from numpy.typing import NDArray

from ...scene.mesh import Mesh

_MIX = np.uint64(0x9E3779B97F4A7C15)  # 2^64 divided by the golden ratio, odd: multiplying by it permutes uint64


def repeated_faces_notes(mesh: Mesh, file: str) -> list[str]:
    """A note with the number of faces that lie on others, with the same corners and facing the same way; [] if none.

    Pairs that face opposite ways, such as walls between two buildings, do not count.
    """
    count = repeated_faces(mesh)
    return [f"{file}: {count} triangles repeat others; areas and energy count them again"] if count else []


def repeated_faces(mesh: Mesh) -> int:
    """The number of faces with the corners of another one, in the same sense of rotation, all three different."""
    words = (mesh.positions.astype(np.float64) + 0.0).view(np.uint64)  # 0.0: -0.0 is 0.0
    code = _hashed(words)
    corners = code.reshape(-1, 3) if mesh.faces is None else code[mesh.faces]
    if len(np.unique(_hashed(_turned(corners)))) == len(corners):  # the usual case, without slow comparisons
        return 0
    _, place = np.unique(mesh.positions, axis=0, return_inverse=True)
    faces = place.reshape(-1, 3) if mesh.faces is None else place.reshape(-1)[mesh.faces]
    faces = faces[(faces != np.roll(faces, 1, axis=1)).all(1)]
    return len(faces) - len(np.unique(_turned(faces), axis=0))


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
