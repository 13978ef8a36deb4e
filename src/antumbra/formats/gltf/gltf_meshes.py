"""glTF mesh primitives: triangles, strips and fans; morph targets and skins; merging of small primitives."""

from collections.abc import Callable, Iterator
from typing import Any, NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray

from ...base.errors import InputError
from ...base.wording import counted
from ...kernels.small_matrices import dot, product
from ...scene.materials import MeshAppearance, look_of, mean_colours, pbr_of
from ...scene.mesh import Mesh, check_faces, check_finite, distinct_vertices, n_faces, used_faces
from ..json_fields import Fields
from .accessors import Accessors, Rows, decompress
from .gltf_materials import GltfMaterials

# --- Primitives: triangles, strips and fans ---------------------------------------------------------------------------


TRIANGLES, STRIP, FAN = 4, 5, 6

_RowsOf: TypeAlias = Callable[..., Any]
"""rows(method of `Accessors`, index, *kinds): the values of the vertices that faces use, one row each."""


class Primitive(NamedTuple):
    """A mesh primitive that consists of triangles, with its skin and morph-target data."""

    mesh: Mesh
    where: str  # name in errors
    targets: np.ndarray | None  # (t, v, 3) float32 or float64, displacements of morph targets
    joints: NDArray[np.int32] | None  # (v, j) int32, indices into the joints of a skin
    weights: NDArray[np.float64] | None  # (v, j) float64, summing to 1
    used: NDArray[np.bool_] | None  # (rows,) bool: the accessor rows that became vertices; None: all
    place: int  # index of the primitive in its mesh
    is_range: bool = False  # whether it has only some of the triangles

    @property
    def triangles(self) -> int:
        return n_faces(self.mesh.positions, self.mesh.faces)


class PrimitiveTriangles(NamedTuple):
    """How the vertices of a primitive form triangles."""

    where: str  # name of the primitive in errors
    mode: int  # TRIANGLES, STRIP or FAN
    n_vertices: int
    corners: int | None  # the accessor of the corners' vertices; None: the vertices in order
    n: int  # triangles

    def faces(self, accessors: Accessors) -> tuple[NDArray[np.int32] | None, NDArray[np.bool_] | None]:
        """`scene.mesh.used_faces` of all triangles; (None, None) if every three vertices are a face."""
        if self.mode == TRIANGLES and self.corners is None:
            return None, None
        if self.corners is None:
            faces = self._numbers(np.arange(self.n))
        else:
            corners = accessors.whole(self.corners, "SCALAR")[:, 0]
            is_list = self.mode == TRIANGLES
            faces = corners.reshape(-1, 3) if is_list else corners[self._numbers(np.arange(self.n))]
        return used_faces(faces, self.n_vertices, self.where)

    def some(
        self, accessors: Accessors, chosen: NDArray[np.int64]
    ) -> tuple[NDArray[np.int32] | None, NDArray[np.int64]]:
        """(faces, the vertices that they use) of triangles whose numbers ascend, as `scene.mesh.distinct_vertices`."""
        numbers = self._numbers(chosen)
        if self.mode == TRIANGLES and self.corners is None:
            return None, numbers.reshape(-1)
        if self.corners is not None:
            read, at = numbers.reshape(-1), np.arange(numbers.size)
            if self.mode != TRIANGLES:
                read, at = np.unique(read, return_inverse=True)
            numbers = accessors.whole(self.corners, "SCALAR", rows=read)[:, 0][at].reshape(-1, 3)
        used, faces = distinct_vertices(check_faces(numbers, self.n_vertices, self.where, int(chosen[0])))
        return faces, used

    def _numbers(self, i: NDArray[np.int64]) -> NDArray[np.int64]:
        """(f, 3): the numbers of the corners of triangles."""
        if self.mode == TRIANGLES:
            return 3 * i[:, None] + np.arange(3)
        if self.mode == STRIP:
            return np.stack([i, i + 1 + i % 2, i + 2 - i % 2], axis=1)
        return np.stack([i + 1, i + 2, i * 0], axis=1)


def triangles_of(fields: Fields, accessors: Accessors) -> PrimitiveTriangles | None:
    """The triangles of a primitive, decompressed; None if it has none (points, lines)."""
    decompress(fields, accessors)
    mode = fields.whole("mode", TRIANGLES, high=7)
    attributes = fields.mapping("attributes", len(accessors))
    if mode < TRIANGLES or "POSITION" not in attributes:
        return None
    n_vertices = count = accessors.count(attributes["POSITION"], "VEC3")
    corners = fields.whole("indices", None, high=len(accessors))
    if corners is not None:
        count = accessors.count(corners, "SCALAR")
    if mode == TRIANGLES and count % 3:
        raise InputError(
            f"{fields.where} has {counted(count, 'corner')}, not a multiple of 3; export the mesh triangulated"
        )
    n = count // 3 if mode == TRIANGLES else max(count - 2, 0)
    return PrimitiveTriangles(fields.where, mode, n_vertices, corners, n) if n else None


class PrimitiveReader:
    """Reads a primitive that has triangles, whole or in parts.

    name : of its mesh
    place : index of the primitive in its mesh
    """

    def __init__(
        self,
        fields: Fields,
        triangles: PrimitiveTriangles,
        name: str,
        accessors: Accessors,
        materials: GltfMaterials,
        place: int,
    ):
        self._fields, self._triangles, self._name, self._place = fields, triangles, name, place
        self._accessors, self._materials = accessors, materials
        self.triangles = triangles.n

    def read(self, chosen: NDArray[np.int64] | None = None) -> Primitive:
        """The primitive; `chosen`: of these triangles, whose numbers ascend, and of the vertices that they use."""
        fields, accessors, n = self._fields, self._accessors, self._triangles.n_vertices
        attributes = fields.mapping("attributes", len(accessors))
        mask: NDArray[np.bool_] | None = None
        used: Rows
        numbers: NDArray[np.int64] | None = None
        if chosen is None:
            faces, mask = self._triangles.faces(accessors)
            used = mask
        else:
            faces, numbers = self._triangles.some(accessors, chosen)
            used = numbers

        def rows(read: Callable[..., np.ndarray], index: int, *kinds: str) -> np.ndarray:
            if (count := accessors.count(index, *kinds)) != n:
                raise InputError(f"{fields.where} has {counted(n, 'position')} but {count} of another attribute")
            return np.array(read(index, *kinds, rows=used))

        targets = _targets(fields, accessors, rows)
        joints, weights = _influences(attributes, accessors, rows)
        vertices = rows(accessors.floats, attributes["POSITION"], "VEC3")
        check_finite(vertices, fields.where, used if mask is None else np.flatnonzero(mask))
        colour, look = _appearance(fields, attributes, accessors, rows, faces, self._materials, vertices)
        mesh = Mesh(self._name, vertices, faces, colour, look, numbers=numbers)
        is_range = chosen is not None and len(chosen) < self.triangles
        return Primitive(mesh, fields.where, targets, joints, weights, mask, self._place, is_range)


def _targets(fields: Fields, accessors: Accessors, rows: _RowsOf) -> np.ndarray | None:
    targets = []
    for target in fields.objects("targets"):
        index = target.whole("POSITION", None, high=len(accessors))
        targets.append(None if index is None else rows(accessors.floats, index, "VEC3"))
    moving = [t for t in targets if t is not None]
    if not moving:
        return None
    for t in moving:
        check_finite(t, f"{fields.where} morph target")
    zero = np.zeros_like(moving[0])
    return np.stack([zero if t is None else t for t in targets])


def _influences(
    attributes: dict[str, int], accessors: Accessors, rows: _RowsOf
) -> tuple[NDArray[np.int32] | None, NDArray[np.float64] | None]:
    """(joints, weights) with the columns of all sets (JOINTS_0, JOINTS_1, ...); weights sum to 1."""
    joints, weights = [], []
    for n in range(len(attributes)):
        if f"JOINTS_{n}" not in attributes or f"WEIGHTS_{n}" not in attributes:
            break
        joints.append(rows(accessors.whole, attributes[f"JOINTS_{n}"], "VEC4"))
        weights.append(rows(accessors.finite, attributes[f"WEIGHTS_{n}"], "VEC4"))
    if not joints:
        return None, None
    joint, weight = np.concatenate(joints, axis=1).astype(np.int64), np.concatenate(weights, axis=1)
    joint[weight == 0.0] = 0  # exporters leave arbitrary joints here
    total = weight.sum(axis=1, keepdims=True)
    weight[:, 0] += (total == 0.0)[:, 0]  # a vertex without weights follows its first joint
    return joint.astype(np.int32), weight / np.where(total == 0.0, 1.0, total)


def _appearance(
    fields: Fields,
    attributes: dict[str, int],
    accessors: Accessors,
    rows: _RowsOf,
    faces: np.ndarray | None,
    materials: GltfMaterials,
    vertices: np.ndarray,
) -> tuple[NDArray[np.float32], MeshAppearance | None]:
    """(mean base colour, (3,) or (f, 3) float32; Look, or None if the mean colour suffices)."""

    def of(name: str, *kinds: str) -> np.ndarray | None:
        return rows(accessors.floats, attributes[name], *kinds) if name in attributes else None

    mapped = materials.of_primitive(fields)
    uv = of(mapped.uv_set, "VEC2") if mapped.material.has_maps else None
    uv = None if uv is None else mapped.transformed(uv)
    colours = of("COLOR_0", "VEC3", "VEC4")
    tangents = of("TANGENT", "VEC4") if pbr_of(mapped.material).normal_map is not None else None
    look = look_of(mapped.material, uv, colours, of("NORMAL", "VEC3"), vertices, tangents)
    second = None if look is None or uv is None or mapped.second_set is None else of(mapped.second_set, "VEC2")
    if look is not None and second is not None:
        look = look._replace(second_uv=np.nan_to_num(np.asarray(second, np.float32)))
    return mean_colours(mapped.material, faces, uv, colours), look


# --- Morph targets and skins, in float64 ------------------------------------------------------------------------------


class Skin(NamedTuple):
    """Joints and their inverse bind matrices."""

    joints: NDArray[np.int64]  # (j,) int64, node indices
    inverse_bind: NDArray[np.float64]  # (j, 4, 4) float64
    where: str  # name in errors


def read_skins(root: Fields, accessors: Accessors, n_nodes: int) -> list[Skin]:
    """All skins of a file."""
    skins = []
    for fields in root.objects("skins"):
        joints = np.array(fields.indices("joints", n_nodes), np.int64)
        inverse = np.tile(np.eye(4), (len(joints), 1, 1))
        index = fields.whole("inverseBindMatrices", None, high=len(accessors))
        if index is not None:
            stored = accessors.finite(index, "MAT4")
            if len(stored) < len(joints):
                raise InputError(
                    f"{fields.where} has {counted(len(joints), 'joint')} but {len(stored)} inverseBindMatrices"
                )
            inverse = stored[: len(joints)].reshape(-1, 4, 4).transpose(0, 2, 1)  # stored by columns
        skins.append(Skin(joints, inverse, fields.where))
    return skins


def check_skin(primitive: Primitive, skin: Skin) -> None:
    """Raise InputError if the primitive uses joints that the skin lacks."""
    if primitive.joints is not None and primitive.joints.size and primitive.joints.max() >= len(skin.joints):
        raise InputError(
            f"{primitive.where} uses joint {primitive.joints.max()}, but {skin.where} has {len(skin.joints)}"
        )


def morphed(primitive: Primitive, weights: np.ndarray) -> np.ndarray:
    """Positions ((v, 3)) plus the weighted displacements of the morph targets."""
    if primitive.targets is None:
        return primitive.mesh.positions
    positions = primitive.mesh.positions.astype(np.float64)
    for weight, target in zip(weights, primitive.targets):
        if weight != 0.0:
            positions += weight * target.astype(np.float64)
    return positions


def skinned(positions: np.ndarray, primitive: Primitive, skin: Skin, world: np.ndarray) -> np.ndarray:
    """World positions ((1, v, 3) float64) of a skinned mesh: the weighted mean over its joints' transforms.

    `world` ((n, 4, 4)) holds the nodes' world matrices. The matrix of the node with the mesh is ignored, as in glTF.
    """
    assert primitive.joints is not None and primitive.weights is not None
    matrices = product(world[skin.joints], skin.inverse_bind)[:, :3]
    homogeneous = np.concatenate([positions.astype(np.float64), np.ones((len(positions), 1))], axis=1)
    out = np.zeros((1, len(positions), 3))
    for joint, weight in zip(primitive.joints.T, primitive.weights.T):
        out[0] += weight[:, None] * dot(matrices[joint], homogeneous[:, None])
    return out


# --- Merging runs of small primitives ---------------------------------------------------------------------------------
#
# Some exporters write thousands of primitives with a few triangles each, and instance their mesh at hundreds of nodes.
# Each placement costs Python time, so runs of consecutive small primitives are merged when the mesh is read. Faces and
# their order do not change.


MAX_RUN_VERTICES = 1 << 14
"""Maximum number of vertices in a run. Larger primitives are not merged: their Python overhead is negligible, and
merging would cost memory."""


def join_small_primitives(primitives: list[Primitive]) -> list[Primitive]:
    """The primitives, with runs of small ones merged. All primitives of a run deform in the same way."""
    runs: list[list[Primitive]] = []
    kind, size = None, 0
    for primitive in primitives:
        n, primitive_kind = len(primitive.mesh.positions), _kind(primitive)
        if not runs or primitive_kind != kind or size + n > MAX_RUN_VERTICES:
            runs.append([])
            size = 0
        runs[-1].append(primitive)
        kind, size = primitive_kind, size + n
    return [run[0] if len(run) == 1 else _merge_run(run) for run in runs]


def _kind(primitive: Primitive) -> tuple[object, ...]:
    """A key that is equal for primitives that deform in the same way."""
    targets, joints = primitive.targets, primitive.joints
    return (
        primitive.mesh.positions.dtype,
        None if targets is None else (len(targets), targets.dtype),
        None if joints is None else joints.shape[1],
    )


def _merge_run(run: list[Primitive]) -> Primitive:
    first, meshes = run[0], [p.mesh for p in run]
    counts = [n_faces(m.positions, m.faces) for m in meshes]
    faces = None
    if any(m.faces is not None for m in meshes):
        faces = np.concatenate([indices + start for indices, start in zip(map(_run_faces, meshes), _starts(meshes))])
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
    """The index of each mesh's first vertex in the merged mesh."""
    yield from np.cumsum([0, *(len(m.positions) for m in meshes[:-1])], dtype=np.int32)


def _run_faces(mesh: Mesh) -> np.ndarray:
    return np.arange(len(mesh.positions), dtype=np.int32).reshape(-1, 3) if mesh.faces is None else mesh.faces


def _look(meshes: list[Mesh], counts: list[int], positions: np.ndarray) -> MeshAppearance | None:
    """The look of merged meshes, with neutral values for attributes that some of them lack."""
    looks = [m.look for m in meshes]
    if all(look is None for look in looks):
        return None
    materials = list(dict.fromkeys(m for look in looks if look is not None for m in look.materials))
    number = {material: i for i, material in enumerate(materials)}
    of_mesh = np.array([-1 if look is None else number[look.materials[0]] for look in looks], np.int32)
    textured = np.array([look is not None and look.uv is not None for look in looks])
    normals, bumpy = _rows(meshes, "normals", 3, 0.0), any(pbr_of(m).normal_map is not None for m in materials)
    return MeshAppearance(
        tuple(materials),
        _rows(meshes, "uv", 2, 0.0),
        _rows(meshes, "colours", 4, 1.0),
        normals,
        None if normals is None and not bumpy else positions,
        np.repeat(of_mesh, counts),
        np.repeat(textured, counts),
        _rows(meshes, "tangents", 4, 0.0),
        _rows(meshes, "second_uv", 2, 0.0),
    )


def _rows(meshes: list[Mesh], name: str, width: int, neutral: float) -> NDArray[np.float32] | None:
    """(v, width) float32: a vertex attribute of all meshes; None if none has it."""
    attributes = [None if m.look is None else getattr(m.look, name) for m in meshes]
    if all(values is None for values in attributes):
        return None

    def neutral_rows(mesh: Mesh) -> NDArray[np.float32]:
        return np.full((len(mesh.positions), width), neutral, np.float32)

    return np.concatenate([neutral_rows(m) if values is None else values for m, values in zip(meshes, attributes)])
