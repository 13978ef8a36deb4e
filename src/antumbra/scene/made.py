"""What scenes hold that are made of arrays, or of meshes of other libraries."""

import numpy as np

from ..checks import as_array, text
from ..errors import InputError
from .crs import checked_crs
from .foreign import meshes_of
from .materials import PLAIN, Material
from .memory import MemoryData
from .mesh import make_mesh
from .painted import painted, picture_texture
from .source import StaticMeshes


def data_of_arrays(
    vertices, faces=None, colours=None, *, vertex_colours=None, uv=None, texture=None, normals=None, name="arrays",
    up="y", crs=None,
) -> MemoryData:  # fmt: skip
    """What a scene of arrays holds; `Scene.from_arrays` documents the arguments."""
    positions, indices = _as_positions(vertices, text(name, "name")), None
    if faces is not None:
        if positions.ndim == 3:
            raise InputError(f"{name}: vertices are a triangle soup (n, 3, 3); leave faces out")
        indices = as_array(faces, f"{name}: faces")
    elif positions.shape[:-1] and positions.reshape(-1, 3).shape[0] % 3:
        raise InputError(f"{name}: {len(positions)} vertices are no multiple of 3; give faces")
    positions = positions.reshape(-1, 3)
    mesh = make_mesh(name, positions, indices, colours, name)
    if any(given is not None for given in (vertex_colours, uv, texture, normals)):
        if colours is not None:
            raise InputError(
                f"{name}: colours and vertex_colours, uv, texture or normals exclude each other; leave colours out"
            )
        material = PLAIN if texture is None else Material(texture=picture_texture(texture, name))
        mesh = painted(mesh, indices, len(positions), material, name, uv, vertex_colours, normals)
    return MemoryData(StaticMeshes([mesh], name), name=name, up=up, crs=None if crs is None else checked_crs(crs))


def data_of_mesh(mesh, *, name: str | None = None, up="y", crs=None) -> MemoryData:
    """What a scene of a mesh holds; `Scene.from_mesh` documents the arguments."""
    name = type(mesh).__name__.lower() if name is None else text(name, "name")
    meshes, notes = meshes_of(mesh, name)
    crs = None if crs is None else checked_crs(crs)
    return MemoryData(StaticMeshes(meshes, name), name=name, up=up, notes=tuple(notes), crs=crs)


def _as_positions(vertices, name: str) -> np.ndarray:
    """`vertices` as (v, 3) or (n, 3, 3) floating point: float32 where that holds them, else float64."""
    positions = as_array(vertices, f"{name}: vertices")
    if positions.shape[-1:] != (3,) or positions.ndim not in (2, 3):
        raise InputError(
            f"{name}: vertices must be numbers, (v, 3) or (n, 3, 3), not {positions.dtype} {positions.shape}"
        )
    if positions.ndim == 3 and positions.shape[1] != 3:
        raise InputError(f"{name}: a triangle soup has shape (n, 3, 3), not {positions.shape}")
    return positions.astype(np.float32 if positions.dtype in (np.float16, np.float32) else np.float64)
