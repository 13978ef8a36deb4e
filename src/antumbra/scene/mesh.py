"""Indexed triangles as a scene stores them, and the checks that all loaders share."""

from typing import NamedTuple

import numpy as np

from ..checks import as_array
from ..errors import InputError
from .colour import BYTE_TO_LINEAR
from .materials import Look

WHITE = np.ones(3, np.float32)


class Mesh(NamedTuple):
    """Triangles in their own frame, in the precision of their file or array."""

    name: str
    positions: np.ndarray  # (v, 3) float32 or float64; faces use all of them
    faces: np.ndarray | None  # (f, 3) int32; None: every three positions are a face
    colour: np.ndarray  # (3,) or (f, 3) float32, linear, in [0, 1]: the mean of what each face shows
    look: Look | None = None  # what it shows beyond that


class MeshInfo(NamedTuple):
    """A summary of a mesh. Its triangles are counted once, not for each instance."""

    name: str  # of the file; "mesh 3" if it has none
    triangles: int  # of one instance
    instances: int  # number of its objects


class ObjectInfo(NamedTuple):
    """An object of a scene: a copy of a mesh, or a city object. The primitives of a glTF mesh belong to one object."""

    name: str  # of the node, else of the mesh; the id of a city object; copies of EXT_mesh_gpu_instancing: "tree[7]"
    mesh: int  # index in `Scene.meshes`; -1 in a store, which records no meshes
    instance: int  # number of this copy among the copies of its mesh, from 0
    type: str = ""  # of a city object, such as "BuildingPart"; "" for others
    parent: str = ""  # of a part, the name of the outermost object that it belongs to, such as the Building; "": none


def make_mesh(name: str, positions, faces, colour, where: str) -> Mesh:
    """A checked `Mesh`; `where` names it in errors. Positions that no face uses are dropped."""
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
    """(faces as int32 into the used vertices, which vertices some face uses: (v,) bool, or None for all)."""
    faces = check_faces(faces, n_vertices, where)
    used = np.zeros(n_vertices, bool)
    used[faces.reshape(-1)] = True
    if used.all():
        return faces, None
    renumbered = np.cumsum(used, dtype=np.int32) - np.int32(1)
    return renumbered[faces], used


def check_faces(faces: np.ndarray, n_vertices: int, where: str) -> np.ndarray:
    """A copy of `faces` as (f, 3) int32. Raises InputError with the first face that uses a missing vertex.

    Kernels trust these numbers, so the caller's array may not be kept: somebody could change it afterwards.
    """
    faces = np.array(faces, order="C")  # before it is checked
    if faces.ndim != 2 or faces.shape[1] != 3 or faces.dtype.kind not in "iu":
        raise InputError(f"{where}: faces must be whole numbers of shape (f, 3), not {faces.dtype} {faces.shape}")
    if faces.size and (faces.min() < 0 or faces.max() >= n_vertices):
        bad = int(np.argmax(((faces < 0) | (faces >= n_vertices)).any(axis=1)))
        raise InputError(
            f"{where}: face {bad} uses vertex {', '.join(map(str, faces[bad].tolist()))}, "
            f"but there are {n_vertices} vertices; export the mesh again"
        )
    return np.ascontiguousarray(faces, np.int32)  # no second copy of int32


def check_finite(positions: np.ndarray, where: str) -> None:
    """Raise InputError with the first vertex that is NaN or infinite."""
    if positions.size == 0 or (np.isfinite(positions.min()) and np.isfinite(positions.max())):
        return
    bad = int(np.argmax(~np.isfinite(positions).all(axis=-1)))
    raise InputError(
        f"{where}: vertex {bad} is {tuple(positions[bad].tolist())}; remove vertices that are NaN or infinite"
    )


def face_colours(colour, count: int, where: str) -> np.ndarray:
    """The checked linear colour as float32 in [0, 1]: one ((3,)), or one for each face ((f, 3))."""
    if colour is None:
        return WHITE
    colour = linear_colours(colour, where)
    if colour.shape not in ((3,), (count, 3)):
        cure = f"give (3,) or ({count}, 3), or vertex_colours"
        raise InputError(f"{where}: colours of {count} faces have shape {colour.shape}; {cure}")
    return colour


def linear_colours(colours, where: str, alpha: bool = False) -> np.ndarray:
    """Colours (..., 3) or (..., 4) as float32, linear light in [0, 1]. Without `alpha`, a fourth number is dropped.

    uint8: sRGB; floating point: linear light. Alpha is linear in both.
    """
    colours = as_array(colours, f"{where}: colours")
    if not (colours.dtype.kind == "f" or colours.dtype == np.uint8) or colours.shape[-1:] not in ((3,), (4,)):
        kinds = "float (linear light, 0 to 1) or uint8 (sRGB), with 3 or 4 of them for each colour"
        raise InputError(f"{where}: colours must be {kinds}, not {colours.dtype} {colours.shape}")
    colours = colours if alpha else colours[..., :3]
    if colours.dtype == np.uint8:
        shown = BYTE_TO_LINEAR.astype(np.float32)[colours[..., :3]]
        return np.concatenate([shown, colours[..., 3:] / np.float32(255.0)], axis=-1)
    if not (colours.size == 0 or (colours.min() >= 0.0 and colours.max() <= 1.0)):
        raise InputError(f"{where}: colours must lie between 0 and 1 (linear light); give uint8 for 0 to 255")
    return colours.astype(np.float32)
