"""Instances: copies of meshes placed by transforms, and `InstancedMeshes`, a scene of them.

A copy is the flattened mesh: its vertices are transformed in float64, recentred and rounded to float32, as
`transform_points` and `triangle_setup` do. What traces instances without flattening them must repeat this arithmetic,
operation by operation (docs/design/instances.md).
"""

from collections.abc import Generator, Iterator, Sequence
from typing import Any, NamedTuple, Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..base.errors import InputError
from ..base.wording import counted
from .mesh import Mesh, MeshInfo, ObjectInfo, Piece, Source, n_faces

VERTEX_BATCH = 1 << 18
"""Vertices of a mesh's copies that are evaluated at once."""

MAX_TRIANGLES = 2**31 - 1
"""Face indices are int32."""

SINGULAR = 1e-12
"""A matrix with unit columns and a smaller determinant counts as singular."""

# --- Transforms -------------------------------------------------------------------------------------------------------


def transform_points(points: np.ndarray, matrices: np.ndarray) -> NDArray[np.float64]:
    """`points` ((v, 3)) under each of `matrices` ((k, 3, 4) or (k, 4, 4) float64): (k, v, 3) float64.

    The order of operations is fixed. The rounding of a matrix product would depend on the machine's BLAS.
    """
    x, y, z = (points[:, i].astype(np.float64) for i in range(3))
    out = np.empty((len(matrices), len(points), 3))
    for i in range(3):
        a, b, c, d = (matrices[:, i, j, None] for j in range(4))
        out[..., i] = a * x + b * y + c * z + d
    return out


def singular(matrices: NDArray[np.float64]) -> NDArray[np.bool_]:
    """(n,) bool: which of (n, 3, 4) or (n, 4, 4) transforms have no inverse, independent of their scale."""
    linear = matrices[:, :3, :3]
    lengths = np.linalg.norm(linear, axis=1)
    with np.errstate(all="ignore"):
        out: NDArray[np.bool_] = ~(np.abs(np.linalg.det(linear / lengths[:, None, :])) > SINGULAR)
        return out  # NaN counts as singular


def copies_in_batches(positions: np.ndarray, matrices: np.ndarray) -> Iterator[tuple[NDArray[np.float64], np.ndarray]]:
    """Yield (world positions (k, v, 3) float64, their k matrices), one batch of copies at a time."""
    batch = max(1, VERTEX_BATCH // max(len(positions), 1))
    for first in range(0, len(matrices), batch):
        chunk = matrices[first : first + batch]
        yield transform_points(positions, chunk), chunk


_NONE = np.empty((0, 3), np.float32)

# --- Instances --------------------------------------------------------------------------------------------------------


class InstancedMesh(NamedTuple):
    """A mesh with copies, in object space. Its faces form parts, such as the primitives of a glTF mesh."""

    positions: np.ndarray  # (v, 3) float32 or float64; faces reference every one
    faces: NDArray[np.int32]  # (f, 3) int32
    colour: NDArray[np.float32]  # (3,) or (f, 3) float32, linear
    parts: NDArray[np.int64]  # (p + 1,): part i has the faces parts[i] to parts[i + 1] - 1
    where: str  # name in errors
    varied: bool  # whether it has textures, vertex colours or normals, beyond one colour per face
    alpha: bool  # whether a material lets light pass


class InstanceSet(NamedTuple):
    """The copies of meshes. Copy i is object i of the scene, and the faces of each of its parts are consecutive."""

    meshes: list[InstancedMesh]
    mesh: NDArray[np.int32]  # (k,): index in `meshes` of each copy
    matrices: NDArray[np.float64]  # (k, 3, 4): object-to-world transforms
    rows: NDArray[np.int64]  # (k + 1,): copy i has the starts from rows[i] to rows[i + 1] - 1
    starts: NDArray[np.int64]  # (s,): for each part of each copy, the scene index of its first face

    @property
    def n_triangles(self) -> int:
        """The number of triangles of all copies."""
        counts = np.array([len(mesh.faces) for mesh in self.meshes], np.int64)
        return int(counts[self.mesh].sum())


class InstancedSource(Source, Protocol):
    """A source that can also give its meshes and transforms, instead of the pieces of all copies."""

    def instances(self) -> InstanceSet:
        """The copies, in the order of the objects. All meshes without copies count as one copy, too."""
        ...


def instanced_mesh(meshes: Sequence[Mesh], where: str) -> InstancedMesh:
    """One instanced mesh from the parts of a mesh, perhaps none; `where` names it in errors."""
    positions, faces, colours, first = [np.empty((0, 3), np.float32)], [np.empty((0, 3), np.int32)], [_NONE], 0
    for mesh in meshes:
        n, indices = n_faces(mesh.positions, mesh.faces), mesh.faces
        if indices is None:
            indices = np.arange(3 * n, dtype=np.int32).reshape(-1, 3)
        positions.append(mesh.positions)
        faces.append(indices + np.int32(first))
        colours.append(np.broadcast_to(mesh.colour, (n, 3)))
        first += len(mesh.positions)
    looks = [mesh.look for mesh in meshes if mesh.look is not None]
    return InstancedMesh(
        np.concatenate(positions),
        np.concatenate(faces),
        meshes[0].colour if len(meshes) == 1 else np.concatenate(colours),
        np.cumsum([0, *map(len, faces[1:])]),
        where,
        any(not look.is_plain for look in looks),
        any(material.lets_light_pass for look in looks for material in look.materials),
    )


def instance_set(
    meshes: list[InstancedMesh], mesh: ArrayLike, matrices: Sequence[np.ndarray], starts: Sequence[np.ndarray]
) -> InstanceSet:
    """An `InstanceSet` from its parts; matrices: (k, 3 or 4, 4) each; starts: of each copy, one number per part."""
    rows = np.cumsum([0, *map(len, starts)], dtype=np.int64)
    return InstanceSet(
        meshes,
        np.array(mesh, np.int32),
        np.ascontiguousarray(np.concatenate([each[:, :3] for each in matrices]), np.float64),
        rows,
        np.concatenate([np.empty(0, np.int64), *starts]).astype(np.int64),
    )


# --- A scene of instances ---------------------------------------------------------------------------------------------


class InstancedMeshes:
    """Static meshes, each with any number of copies. Faces are ordered by mesh, then by copy.

    meshes : list of Mesh
    matrices : list of (k, 3, 4) float64, the object-to-world transforms of each mesh's copies
    """

    duration = 0.0

    def __init__(self, meshes: list[Mesh], matrices: list[NDArray[np.float64]], file: str):
        self._meshes, self._matrices, self.file = meshes, matrices, file
        self.meshes = [
            MeshInfo(mesh.name, n_faces(mesh.positions, mesh.faces), len(of_mesh))
            for mesh, of_mesh in zip(meshes, matrices)
        ]
        self.objects = [
            ObjectInfo(f"{info.name}[{k}]", i, k) for i, info in enumerate(self.meshes) for k in range(info.instances)
        ]
        total = sum(info.triangles * info.instances for info in self.meshes)
        if total > MAX_TRIANGLES:
            raise InputError(f"{file}: {counted(total, 'triangle')} with all instances; at most {MAX_TRIANGLES} fit")
        for info, of_mesh in zip(self.meshes, matrices):
            flat = np.flatnonzero(singular(of_mesh))
            if len(flat):
                raise InputError(
                    f'{file}: instance {flat[0]} of mesh "{info.name}" has a transform without inverse; '
                    "remove the instance"
                )

    def instances(self) -> InstanceSet:
        meshes = [instanced_mesh([mesh], self._where(mesh)) for mesh in self._meshes]
        counts = [info.instances for info in self.meshes]
        sizes = np.repeat([info.triangles for info in self.meshes], counts)
        starts = np.cumsum([0, *sizes])[:-1]
        return instance_set(
            meshes, np.repeat(np.arange(len(meshes)), counts), self._matrices, list(starts.reshape(-1, 1))
        )

    def pieces(self, time: float) -> Generator[Piece, None, None]:
        first = 0
        for mesh, matrices in zip(self._meshes, self._matrices):
            for vertices, of_copies in copies_in_batches(mesh.positions, matrices):
                linear = of_copies[:, :3, :3]
                yield Piece(
                    vertices, mesh.faces, mesh.colour, self._where(mesh), first=first, look=mesh.look, linear=linear
                )
                first += len(vertices)

    def _where(self, mesh: Mesh) -> str:
        return f'{self.file}: mesh "{mesh.name}"'

    def cameras(self, time: float) -> list[Any]:
        return []

    def lights(self, time: float) -> list[Any]:
        return []
