"""Indexed triangle meshes, the checks shared by all loaders, and `Source`, the geometry interface of a scene.

A `Source` yields `Piece`s, meshes in world space at one moment. `StaticMeshes` is its simplest implementation.
`textured_mesh` adds materials, textures and vertex colours to a checked mesh.
"""

from collections.abc import Generator
from typing import Any, NamedTuple, Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..base.checks import as_array
from ..base.errors import InputError
from ..base.wording import counted
from .materials import BYTE_TO_LINEAR, PLAIN, Material, MeshAppearance, Texture, look_of, mean_colours

# --- Indexed triangles and their checks -------------------------------------------------------------------------------


WHITE = np.ones(3, np.float32)

_SPARSE = 8  # indices whose range is this many times their number are sorted, not counted


class Mesh(NamedTuple):
    """Triangles in object space, in the precision of their file or array."""

    name: str
    positions: np.ndarray  # (v, 3) float32 or float64; faces reference every one
    faces: NDArray[np.int32] | None  # (f, 3) int32; None: every three positions are a face
    colour: NDArray[np.float32]  # (3,) or (f, 3) float32, linear, in [0, 1]: mean colours
    look: MeshAppearance | None = None  # textures, vertex colours, normals; None: the mean colours suffice
    used: NDArray[np.bool_] | None = None  # (v0,) bool: which vertices of the array are `positions`; None: all
    numbers: NDArray[np.int64] | None = None  # (v,) ascending: of vertices in the mesh of which this is a part


class MeshInfo(NamedTuple):
    """A summary of a mesh. Its triangles are counted once, not per instance."""

    name: str  # from the file; "mesh 3" if it gives none
    triangles: int  # of one instance
    instances: int  # number of its objects


class ObjectInfo(NamedTuple):
    """An object of a scene: a copy of a mesh, or a city object. The primitives of a glTF mesh belong to one object."""

    name: str  # of the node, the mesh or an ancestor; id of a city object; copies of EXT_mesh_gpu_instancing: "tree[7]"
    mesh: int  # index in `Scene.meshes`; -1 in a store, which records no meshes
    instance: int  # index of this copy among the copies of its mesh, from 0
    type: str = ""  # of a city object, such as "BuildingPart"; "" for others
    parent: str = ""  # of a part: name of the outermost object that contains it, such as the Building; "": none


def make_mesh(name: str, positions: NDArray[Any], faces: NDArray[Any] | None, colour: object, where: str) -> Mesh:
    """A checked `Mesh`; `where` names it in errors. Unused positions are dropped."""
    used = None
    if faces is None:
        positions = np.array(positions)
    else:
        faces, used = used_faces(faces, len(positions), where)
        positions = np.array(positions if used is None else positions[used])
    check_finite(positions, where)
    positions = _single_if_exact(positions)
    return Mesh(name, positions, faces, face_colours(colour, n_faces(positions, faces), where), used=used)


def _single_if_exact(positions: NDArray[Any]) -> NDArray[Any]:
    """The positions in float32, if it holds all of them: scenes of such meshes round nothing, see `frame_origin`."""
    with np.errstate(over="ignore"):
        single = positions.astype(np.float32, copy=False)
    return single if np.array_equal(single, positions) else positions


def n_faces(positions: np.ndarray, faces: np.ndarray | None) -> int:
    """The number of faces; `faces` None: three vertices each."""
    return len(positions) // 3 if faces is None else len(faces)


def used_faces(faces: np.ndarray, n_vertices: int, where: str) -> tuple[np.ndarray, np.ndarray | None]:
    """(faces as int32 indices of the used vertices, mask of the used vertices ((v,) bool), or None if all are used)."""
    faces = check_faces(faces, n_vertices, where)
    used = np.zeros(n_vertices, bool)
    used[faces.reshape(-1)] = True
    if used.all():
        return faces, None
    renumbered = np.cumsum(used, dtype=np.int32) - np.int32(1)
    return renumbered[faces], used


def distinct_vertices(faces: np.ndarray) -> tuple[NDArray[np.int64], NDArray[np.int32]]:
    """(the vertices that faces use, ascending; the faces as (f, 3) int32 indices of these). There is at least one."""
    low, high = int(faces.min()), int(faces.max())
    if high - low >= _SPARSE * faces.size:
        used, local = np.unique(faces, return_inverse=True)
        return used.astype(np.int64), local.reshape(-1, 3).astype(np.int32)
    shifted, there = faces.astype(np.int64) - low, np.zeros(high - low + 1, bool)
    there[shifted.reshape(-1)] = True
    number = np.cumsum(there, dtype=np.int32) - np.int32(1)
    return np.flatnonzero(there) + low, number[shifted]


def check_faces(faces: np.ndarray, n_vertices: int, where: str, first: int = 0) -> np.ndarray:
    """A copy of `faces` as (f, 3) int32. Raises InputError with the first face that uses a missing vertex.

    Kernels do not check these indices, hence the copy: the caller could modify the array later.

    first : number of the first face, for the error
    """
    faces = np.array(faces, order="C")  # copy before checking
    if faces.ndim != 2 or faces.shape[1] != 3 or faces.dtype.kind not in "iu":
        raise InputError(f"{where}: faces must be whole numbers of shape (f, 3), not {faces.dtype} {faces.shape}")
    if faces.size and (faces.min() < 0 or faces.max() >= n_vertices):
        bad = int(np.argmax(((faces < 0) | (faces >= n_vertices)).any(axis=1)))
        raise InputError(
            f"{where}: face {first + bad} uses the vertices {', '.join(map(str, faces[bad].tolist()))}, "
            f"and the mesh has {counted(n_vertices, 'vertex')}, counted from 0; export the mesh again"
        )
    return np.ascontiguousarray(faces, np.int32)  # no second copy of int32


def check_finite(positions: np.ndarray, where: str, numbers: np.ndarray | None = None) -> None:
    """Raise InputError with the first vertex that is NaN or infinite.

    numbers : of the vertices, for the error; None: from 0
    """
    if positions.size == 0 or (np.isfinite(positions.min()) and np.isfinite(positions.max())):
        return
    bad = int(np.argmax(~np.isfinite(positions).all(axis=-1)))
    number = bad if numbers is None else int(numbers[bad])
    raise InputError(
        f"{where}: vertex {number} is {tuple(positions[bad].tolist())}; remove vertices that are NaN or infinite"
    )


def face_colours(colour: object, count: int, where: str) -> NDArray[np.float32]:
    """The checked linear colour as float32 in [0, 1]: one ((3,)), or one per face ((f, 3))."""
    if colour is None:
        return WHITE
    colour = linear_colours(colour, where)
    if colour.shape not in ((3,), (count, 3)):
        cure = f"give (3,) or ({count}, 3), or vertex_colours"
        raise InputError(f"{where}: colours of {counted(count, 'face', 'have')} shape {colour.shape}; {cure}")
    return colour


def linear_colours(colours: object, where: str, alpha: bool = False) -> NDArray[np.float32]:
    """Colours (..., 3) or (..., 4) as float32, linear light in [0, 1]. Without `alpha`, a fourth component is dropped.

    uint8 input is sRGB, floating-point input is linear light. Alpha is linear in both.
    """
    colours = as_array(colours, f"{where}: colours")
    if not (colours.dtype.kind == "f" or colours.dtype == np.uint8) or colours.shape[-1:] not in ((3,), (4,)):
        kinds = "float (linear light, 0 to 1) or uint8 (sRGB), with 3 or 4 of them for each colour"
        raise InputError(f"{where}: colours must be {kinds}, not {colours.dtype} {colours.shape}")
    colours = colours if alpha else colours[..., :3]
    if colours.dtype == np.uint8:
        rgb = BYTE_TO_LINEAR.astype(np.float32)[colours[..., :3]]
        return np.concatenate([rgb, colours[..., 3:] / np.float32(255.0)], axis=-1)
    if not (colours.size == 0 or (colours.min() >= 0.0 and colours.max() <= 1.0)):
        raise InputError(f"{where}: colours must lie between 0 and 1 (linear light); give uint8 for 0 to 255")
    return colours.astype(np.float32)


# --- The geometry interface of a scene, and static meshes -------------------------------------------------------------


class Piece(NamedTuple):
    """A part of a scene at one moment: `k` copies of a mesh, in world space."""

    vertices: np.ndarray  # (k, v, 3) float32 or float64, world
    faces: NDArray[np.int32] | None  # (f, 3) int32; None: every three vertices are a face
    colour: NDArray[np.float32]  # (3,) or (f, 3) float32, linear
    where: str  # name in errors
    towards: np.ndarray | None = None  # (k, v, 3): vertices are (1 - share) * vertices + share * towards
    share: float = 0.0
    first: int = 0  # copy i is the object `first + i` of the source
    owners: NDArray[np.int32] | None = None  # (f,) int32: the object of each face if the piece has several; then k = 1
    look: MeshAppearance | None = None  # of the mesh
    linear: NDArray[np.float64] | None = None  # (k, 3, 3) float64: object-to-world, for the look's normals; None: 1
    used: NDArray[np.bool_] | None = None  # (v0,) bool: as in `Mesh`
    is_range: bool = False  # whether other pieces may have faces at the same vertices
    numbers: NDArray[np.int64] | None = None  # (v,): as in `Mesh`; None: not known, or not `is_range`


class Source(Protocol):
    """Geometry, cameras and lights as a function of time in seconds, 0 <= time <= duration."""

    file: str  # name in errors
    duration: float
    meshes: list[MeshInfo]
    objects: list[ObjectInfo]

    def pieces(self, time: float) -> Generator[Piece, None, None]:
        """The pieces at `time`. Their order and faces are the same at every time."""
        ...

    def cameras(self, time: float) -> list[Any]: ...  # of Camera, which imports this module

    def lights(self, time: float) -> list[Any]: ...  # of Light


class SpannedSource(Source, Protocol):
    """A source whose pieces come in spans, each of which can be read alone."""

    @property
    def n_spans(self) -> int: ...

    def span(self, k: int) -> Generator[Piece, None, None]:
        """The pieces of span k at time 0. Those of all spans in order are `pieces`."""
        ...


class StaticMeshes:
    """Meshes in world space that never move."""

    duration = 0.0

    def __init__(self, meshes: list[Mesh], file: str):
        self._meshes = meshes
        self.file = file
        self.meshes = [MeshInfo(m.name, n_faces(m.positions, m.faces), 1) for m in meshes]
        self.objects = [ObjectInfo(m.name, i, 0) for i, m in enumerate(meshes)]

    def pieces(self, time: float) -> Generator[Piece, None, None]:
        for i, mesh in enumerate(self._meshes):
            where = f'{self.file}: mesh "{mesh.name}"'
            yield Piece(mesh.positions[None], mesh.faces, mesh.colour, where, first=i, look=mesh.look, used=mesh.used)

    def cameras(self, time: float) -> list[Any]:
        return []

    def lights(self, time: float) -> list[Any]:
        return []


# --- Meshes with materials, textures and vertex colours ---------------------------------------------------------------


class VertexAttributes(NamedTuple):
    """Attributes of the v vertices of a mesh, unchecked."""

    uv: object = None  # (v, 2) float, texture coordinates, v down
    colours: object = None  # (v, 3 or 4) float (linear) or uint8 (sRGB)
    normals: object = None  # (v, 3) float


def textured_mesh(
    mesh: Mesh,
    faces: ArrayLike | None,
    n_vertices: int,
    material: Material | None,
    where: str,
    attributes: VertexAttributes,
) -> Mesh:
    """A mesh from `make_mesh`, with the vertex attributes of its file or library.

    faces, n_vertices : the original faces and vertex count, since `make_mesh` drops unused vertices
    material : None: the faces keep their colours, so normals are the only attributes that count

    Raises
    ------
    InputError
        If an attribute does not have one row per vertex.
    ValueError
        If the texture cannot be decoded.
    """
    used = None if faces is None else used_faces(np.asarray(faces), n_vertices, where)[1]

    def rows(values: np.ndarray | None) -> np.ndarray | None:
        return values if values is None or used is None else values[used]

    colours = None
    if attributes.colours is not None:
        colours = linear_colours(attributes.colours, where, alpha=True)
        if colours.ndim != 2 or len(colours) != n_vertices:
            raise InputError(
                f"{where}: vertex_colours of {counted(n_vertices, 'vertex', 'have')} shape {colours.shape}"
            )
    normals = _checked_attribute(attributes.normals, (n_vertices, 3), f"{where}: normals")
    if material is None:
        if normals is None:
            return mesh
        of_face = np.full(n_faces(mesh.positions, mesh.faces), -1, np.int32)
        look = look_of(PLAIN, normals=rows(normals), rest_positions=mesh.positions)
        return mesh._replace(look=None if look is None else look._replace(material_of_face=of_face))
    uv, colours = rows(_checked_attribute(attributes.uv, (n_vertices, 2), f"{where}: uv")), rows(colours)
    look = look_of(material, uv, colours, rows(normals), mesh.positions)
    return mesh._replace(colour=mean_colours(material, mesh.faces, uv, colours), look=look)


def _checked_attribute(values: object, shape: tuple[int, int], where: str) -> np.ndarray | None:
    if values is None:
        return None
    values = as_array(values, where)
    if values.shape != shape:
        raise InputError(f"{where} must be numbers {shape}, one row for each vertex, not {values.dtype} {values.shape}")
    return values


def picture_texture(picture: object, where: str) -> Texture:
    """A texture from an sRGB array, (h, w, 3) or (h, w, 4) uint8."""
    pixels = as_array(picture, f"{where}: texture")
    if pixels.dtype != np.uint8 or pixels.ndim != 3 or pixels.shape[2] not in (3, 4) or not pixels.size:
        raise InputError(f"{where}: texture must be (h, w, 3) or (h, w, 4) uint8, not {pixels.dtype} {pixels.shape}")
    opaque = np.full((*pixels.shape[:2], 1), 255, np.uint8)
    return Texture(where, np.ascontiguousarray(np.concatenate([pixels, opaque], axis=2)[..., :4]))


def flip_v(uv: ArrayLike | None, n_vertices: int) -> np.ndarray | None:
    """Texture coordinates of trimesh and OBJ, whose v points up, with v down; None unless their shape is (n, 2)."""
    coordinates = np.asarray([] if uv is None else uv)
    return np.array([0, 1]) + np.array([1, -1]) * coordinates if coordinates.shape == (n_vertices, 2) else None
