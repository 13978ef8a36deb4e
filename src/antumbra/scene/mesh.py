"""Indexed triangles as a scene stores them, and the checks that every loader shares."""

from typing import NamedTuple

import numpy as np

from ..errors import InputError

WHITE = np.ones(3, np.float32)


class Mesh(NamedTuple):
    """Triangles in their own frame, in the precision they came in."""

    name: str
    positions: np.ndarray  # (v, 3) float32 or float64, every one used by some face
    faces: np.ndarray | None  # (f, 3) int32; None: three positions in a row are a face
    colour: np.ndarray  # (3,) or (f, 3) float32, linear, in [0, 1]


class MeshInfo(NamedTuple):
    """What there is to say about a mesh: its triangles are counted once, however often it is instanced."""

    name: str
    triangles: int
    instances: int


def make_mesh(name: str, positions, faces, colour, where: str) -> Mesh:
    """A checked `Mesh`; `where` is what errors call it. Positions that no face uses are dropped."""
    if faces is None:
        positions = np.array(positions)
    else:
        faces, used = used_faces(faces, len(positions), where)
        positions = np.array(positions if used is None else positions[used])
    check_finite(positions, where)
    return Mesh(name, positions, faces, face_colours(colour, n_faces(positions, faces), where))


def n_faces(positions: np.ndarray, faces: np.ndarray | None) -> int:
    return len(positions) // 3 if faces is None else len(faces)


def used_faces(faces: np.ndarray, n_vertices: int, where: str) -> tuple[np.ndarray, np.ndarray | None]:
    """Faces as int32 into the vertices that some face uses, and which those are ((v,) bool; None: all)."""
    faces = check_faces(faces, n_vertices, where)
    used = np.zeros(n_vertices, bool)
    used[faces.reshape(-1)] = True
    if used.all():
        return faces, None
    renumbered = np.cumsum(used, dtype=np.int32) - np.int32(1)
    return renumbered[faces], used


def check_faces(faces: np.ndarray, n_vertices: int, where: str) -> np.ndarray:
    """`faces` as (f, 3) int32, or InputError naming the first face that reaches beyond the vertices."""
    if faces.ndim != 2 or faces.shape[1] != 3 or faces.dtype.kind not in "iu":
        raise InputError(f"{where}: faces must be whole numbers of shape (f, 3), not {faces.dtype} {faces.shape}")
    if faces.size and (faces.min() < 0 or faces.max() >= n_vertices):
        bad = int(np.argmax(((faces < 0) | (faces >= n_vertices)).any(axis=1)))
        raise InputError(
            f"{where}: face {bad} uses vertex {', '.join(map(str, faces[bad].tolist()))}, "
            f"but there are {n_vertices} vertices; export the mesh again"
        )
    return np.ascontiguousarray(faces, np.int32)


def check_finite(positions: np.ndarray, where: str) -> None:
    """InputError naming the first vertex that is NaN or infinite."""
    if positions.size == 0 or (np.isfinite(positions.min()) and np.isfinite(positions.max())):
        return
    bad = int(np.argmax(~np.isfinite(positions).all(axis=-1)))
    raise InputError(
        f"{where}: vertex {bad} is {tuple(positions[bad].tolist())}; remove vertices that are NaN or infinite"
    )


def face_colours(colour, count: int, where: str) -> np.ndarray:
    """One linear colour ((3,)) or one for each face ((f, 3)), as float32 in [0, 1]."""
    if colour is None:
        return WHITE
    colour = np.asarray(colour)
    if colour.dtype.kind != "f" or colour.shape not in ((3,), (count, 3)):
        raise InputError(f"{where}: colours must be floats, (3,) or ({count}, 3), not {colour.dtype} {colour.shape}")
    if not (colour.size == 0 or (colour.min() >= 0.0 and colour.max() <= 1.0)):
        raise InputError(f"{where}: colours must lie between 0 and 1 (linear light)")
    return np.array(colour, np.float32)
