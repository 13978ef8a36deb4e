"""Runs: small primitives of a mesh, one after the other, that are placed as one.

Some exporters write thousands of primitives with a few triangles each, and show their mesh at hundreds of nodes. Each
placement costs Python time, so they are joined where the mesh is read. Faces and their order stay as they are.
"""

from collections.abc import Iterator

import numpy as np

from ..materials import Look
from ..mesh import Mesh, n_faces
from .primitives import Primitive

MOST = 1 << 14
"""Vertices of a run. Larger primitives stay alone: for them Python's time does not count, but memory does."""


def runs_of(primitives: list[Primitive]) -> list[Primitive]:
    """The primitives, with runs of small ones joined. Those of a run move in the same way."""
    runs: list[list[Primitive]] = []
    kind, size = None, 0
    for primitive in primitives:
        n, own = len(primitive.mesh.positions), _kind(primitive)
        if not runs or own != kind or size + n > MOST:
            runs.append([])
            size = 0
        runs[-1].append(primitive)
        kind, size = own, size + n
    return [run[0] if len(run) == 1 else _joined(run) for run in runs]


def _kind(primitive: Primitive) -> tuple:
    """What must be equal for primitives to move in the same way."""
    targets, joints = primitive.targets, primitive.joints
    return (
        primitive.mesh.positions.dtype,
        None if targets is None else (len(targets), targets.dtype),
        None if joints is None else joints.shape[1],
    )


def _joined(run: list[Primitive]) -> Primitive:
    first, meshes = run[0], [p.mesh for p in run]
    counts = [n_faces(m.positions, m.faces) for m in meshes]
    faces = None
    if any(m.faces is not None for m in meshes):
        faces = np.concatenate([own + start for own, start in zip(map(_faces, meshes), _starts(meshes))])
    colour = np.concatenate([np.broadcast_to(m.colour, (n, 3)) for m, n in zip(meshes, counts)])
    if (colour == colour[0]).all():
        colour = colour[0]
    positions = np.concatenate([m.positions for m in meshes])
    mesh = Mesh(first.mesh.name, positions, faces, colour, _look(meshes, counts, positions))
    return first._replace(
        mesh=mesh,
        where=f"{first.where} to {run[-1].where.rpartition('.')[2]}",
        targets=None if first.targets is None else np.concatenate([p.targets for p in run], axis=1),
        joints=None if first.joints is None else np.concatenate([p.joints for p in run]),
        weights=None if first.weights is None else np.concatenate([p.weights for p in run]),
        used=None,
    )


def _starts(meshes: list[Mesh]) -> Iterator[np.int32]:
    """The first vertex of each mesh among those of all."""
    yield from np.cumsum([0, *(len(m.positions) for m in meshes[:-1])], dtype=np.int32)


def _faces(mesh: Mesh) -> np.ndarray:
    return np.arange(len(mesh.positions), dtype=np.int32).reshape(-1, 3) if mesh.faces is None else mesh.faces


def _look(meshes: list[Mesh], counts: list[int], positions: np.ndarray) -> Look | None:
    """The look of joined meshes: rows of an attribute that some of them lack have its neutral value."""
    looks = [m.look for m in meshes]
    if all(look is None for look in looks):
        return None
    materials = list(dict.fromkeys(m for look in looks if look is not None for m in look.materials))
    number = {material: i for i, material in enumerate(materials)}
    of_mesh = np.array([-1 if look is None else number[look.materials[0]] for look in looks], np.int32)
    textured = np.array([look is not None and look.uv is not None for look in looks])
    rows = lambda name, width, neutral: _rows(meshes, name, width, neutral)
    normals = rows("normals", 3, 0.0)
    return Look(
        tuple(materials), rows("uv", 2, 0.0), rows("colours", 4, 1.0), normals, None if normals is None else positions,
        np.repeat(of_mesh, counts), np.repeat(textured, counts),
    )  # fmt: skip


def _rows(meshes: list[Mesh], name: str, width: int, neutral: float) -> np.ndarray | None:
    """(v, width) float32: an attribute of the vertices of all meshes; None: none has it."""
    given = [None if m.look is None else getattr(m.look, name) for m in meshes]
    if all(values is None for values in given):
        return None
    lacking = lambda mesh: np.full((len(mesh.positions), width), neutral, np.float32)
    return np.concatenate([lacking(m) if values is None else values for m, values in zip(meshes, given)])
