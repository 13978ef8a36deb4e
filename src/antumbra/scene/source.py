"""The interface of a `Scene` to its geometry, and its simplest implementation: meshes that never move."""

from collections.abc import Iterator
from typing import NamedTuple, Protocol

import numpy as np

from .materials import Look
from .mesh import Mesh, MeshInfo, ObjectInfo, n_faces


class Piece(NamedTuple):
    """Part of a scene at one moment: `k` copies of a mesh, in world space."""

    vertices: np.ndarray  # (k, v, 3) float32 or float64, world
    faces: np.ndarray | None  # (f, 3) int32; None: every three vertices are a face
    colour: np.ndarray  # (3,) or (f, 3) float32, linear
    where: str  # name in errors
    towards: np.ndarray | None = None  # (k, v, 3): vertices are (1 - share) * vertices + share * towards
    share: float = 0.0
    first: int = 0  # copy i is the object `first + i` of the source
    owners: np.ndarray | None = None  # (f,) int32: the object of each face, of a piece with several; then k = 1
    look: Look | None = None  # what the mesh shows beyond its colour
    linear: np.ndarray | None = None  # (k, 3, 3) float64: transforms of the look's normals to world space; None: 1


class Source(Protocol):
    """Geometry, cameras and lights as a function of time in seconds, 0 <= time <= duration."""

    file: str  # name in errors
    duration: float
    meshes: list[MeshInfo]
    objects: list[ObjectInfo]

    def pieces(self, time: float) -> Iterator[Piece]:
        """The pieces. Their order and faces are the same at every time."""
        ...

    def cameras(self, time: float) -> list: ...

    def lights(self, time: float) -> list: ...


class StaticMeshes:
    """Meshes in world space that never move."""

    duration = 0.0

    def __init__(self, meshes: list[Mesh], file: str):
        self._meshes = meshes
        self.file = file
        self.meshes = [MeshInfo(m.name, n_faces(m.positions, m.faces), 1) for m in meshes]
        self.objects = [ObjectInfo(m.name, i, 0) for i, m in enumerate(meshes)]

    def pieces(self, time: float) -> Iterator[Piece]:
        for i, mesh in enumerate(self._meshes):
            where = f'{self.file}: mesh "{mesh.name}"'
            yield Piece(mesh.positions[None], mesh.faces, mesh.colour, where, first=i, look=mesh.look)

    def cameras(self, time: float) -> list:
        return []

    def lights(self, time: float) -> list:
        return []
