"""Scenes of instances from arrays."""

from collections.abc import Sequence
from itertools import repeat
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

from ..base.checks import as_array, flag, text
from ..base.errors import InputError
from ..base.wording import counted
from ..scene.crs import checked_crs
from ..scene.instance_data import InstanceData, wants_instances
from ..scene.instances import InstancedMeshes
from ..scene.mesh import Mesh, make_mesh
from ..scene.scene_data import MemoryData, check_up_axis
from ..scene.units import LengthUnit
from .library_meshes import positions_of


def data_of_instances(
    meshes: object,
    transforms: object,
    colours: object = None,
    *,
    name: str = "instances",
    up: str = "y",
    crs: object = None,
    unit: "str | LengthUnit | None" = None,
    instances: bool | None = None,
) -> InstanceData | MemoryData:
    """Scene data of instances; `Scene.from_instances` documents the arguments."""
    name, up = text(name, "name"), check_up_axis(up)
    if instances is not None:
        flag(instances, "instances")
    parts, placed = _listed(meshes, name, "meshes"), _listed(transforms, name, "transforms")
    of_meshes = list(repeat(None, len(parts))) if colours is None else _listed(colours, name, "colours")
    if not len(parts) == len(placed) == len(of_meshes):
        raise InputError(
            f"{name}: there are {counted(len(parts), 'mesh')}, {counted(len(placed), 'array')} of transforms and "
            f"{counted(len(of_meshes), 'colour')}; "
            "give one of each per mesh"
        )
    checked = [
        _mesh(part, colour, f"mesh {i}", f"{name}: mesh {i}") for i, (part, colour) in enumerate(zip(parts, of_meshes))
    ]
    matrices = [_matrices(each, f"{name}: transforms of mesh {i}") for i, each in enumerate(placed)]
    source, known = InstancedMeshes(checked, matrices, name), None if crs is None else checked_crs(crs)
    if wants_instances(source, instances):
        return InstanceData(source, name=name, up=up, crs=known, unit=unit)
    return MemoryData(source, name=name, up=up, crs=known, unit=unit)


def _listed(values: object, name: str, what: str) -> list[Any]:
    is_array = isinstance(values, np.ndarray) and values.ndim > 0
    if not is_array and not (isinstance(values, Sequence) and not isinstance(values, str | bytes)):
        raise InputError(f"{name}: {what} is a {type(values).__name__}; give a list with one entry per mesh")
    return list(cast("Sequence[Any]", values))


def _mesh(part: Any, colour: object, name: str, where: str) -> Mesh:
    """A mesh of (vertices, faces), or of a triangle soup."""
    vertices, faces = part if isinstance(part, tuple | list) and len(part) == 2 else (part, None)
    positions = positions_of(vertices, where)
    if faces is None and positions.ndim == 2:
        raise InputError(f"{where}: give (vertices, faces), or a triangle soup (n, 3, 3)")
    if faces is not None and positions.ndim == 3:
        raise InputError(f"{where}: vertices are a triangle soup (n, 3, 3); leave faces out")
    indices = None if faces is None else as_array(faces, f"{where}: faces")
    return make_mesh(name, positions.reshape(-1, 3), indices, colour, where)


def _matrices(values: object, where: str) -> NDArray[np.float64]:
    """(k, 3, 4) float64: checked object-to-world transforms."""
    matrices = as_array(values, where)
    if matrices.ndim != 3 or matrices.shape[1:] not in ((3, 4), (4, 4)):
        raise InputError(f"{where} must be numbers (k, 4, 4) or (k, 3, 4), not {matrices.dtype} {matrices.shape}")
    if not np.isfinite(matrices).all():
        raise InputError(f"{where} hold NaN or infinity")
    if matrices.shape[1] == 4 and not (matrices[:, 3] == (0.0, 0.0, 0.0, 1.0)).all():
        raise InputError(f"{where} must be affine: each last row must be 0, 0, 0, 1")
    return np.ascontiguousarray(matrices[:, :3], np.float64)
