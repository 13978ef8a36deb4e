"""The primitives of a glTF file by node: world positions and normals, and edits of attributes and materials."""

import copy
from collections.abc import Callable, Hashable, Sequence
from pathlib import Path
from typing import Any, NamedTuple, TypeVar

import numpy as np
from numpy.typing import NDArray

from ..engine.scene import Scene
from ..formats.gltf.accessors import Accessors
from ..formats.gltf.gltf_asset import Asset
from ..formats.gltf.gltf_file import GltfDocument
from ..formats.gltf.gltf_source import PlacedPrimitive
from ..formats.gltf.gltf_writer import Json
from ..formats.json_fields import Fields
from ..kernels.small_matrices import inverse, product
from .smooth_normals import face_vectors, smooth_normals

# --- Primitives at nodes ----------------------------------------------------------------------------------------------


class NodePrimitive(NamedTuple):
    """A primitive at a node, at the time of a bake: a part of the scene."""

    node: int
    place: int  # index of the primitive in its mesh
    where: str  # name in errors
    json: Json  # the primitive in the file
    rows: np.ndarray  # (v,) int64: rows of the accessors that its faces use, in order
    row_count: int  # all rows of the accessors
    positions: np.ndarray  # (v, 3) float64, world
    normals: np.ndarray  # (v, 3) float64, unit, world
    faces: np.ndarray  # (f, 3) int32 into `positions`
    flat: bool  # no NORMAL in the file: viewers shade each face with its own normal
    linear: np.ndarray  # (3, 3) float64, the node's transform without translation; identity if a skin moves the part
    sign: float  # -1.0 if the node mirrors, which reverses the winding of faces


def read_primitives(scene: Scene, asset: Asset, time: float) -> list[NodePrimitive]:
    """The parts of a scene whose source is a glTF file, in face order.

    asset : the same file
    """
    accessors, parts = accessors_of(asset, scene.name), []
    source: Any = scene.source  # of a glTF file
    for placed in source.placed(scene.clamped(time)):
        primitive, (positions,) = placed.primitive, placed.vertices
        json = primitive_json(asset, placed)
        count = asset.json["accessors"][json["attributes"]["POSITION"]]["count"]
        rows = np.arange(count) if primitive.used is None else np.flatnonzero(primitive.used)
        faces = primitive.mesh.faces
        faces = np.arange(len(rows), dtype=np.int32).reshape(-1, 3) if faces is None else faces
        moved = placed.skinned or primitive.targets is not None
        linear = np.eye(3) if placed.skinned else placed.matrix[:3, :3]
        sign = -1.0 if np.linalg.det(linear) < 0.0 else 1.0
        stored = json["attributes"].get("NORMAL")
        file_normals = None if stored is None else accessors.floats(stored, "VEC3")[rows].astype(np.float64)
        if file_normals is None or moved:
            keys = (
                primitive.mesh.positions
                if file_normals is None
                else np.concatenate([primitive.mesh.positions, file_normals], 1)
            )
            normals = smooth_normals(positions, faces, keys) * sign
        else:
            normals = product(file_normals, inverse(linear))
        normals = _unit(normals, positions, faces, sign)
        parts.append(
            NodePrimitive(
                placed.node,
                primitive.place,
                primitive.where,
                json,
                rows,
                count,
                positions,
                normals,
                faces,
                stored is None,
                linear,
                sign,
            )
        )
    return parts


def primitive_json(asset: Asset, placed: PlacedPrimitive) -> Json:
    """The JSON of a primitive at a node."""
    meshes, nodes = asset.json["meshes"], asset.json["nodes"]
    primitive: Json = meshes[nodes[placed.node]["mesh"]]["primitives"][placed.primitive.place]
    return primitive


def accessors_of(asset: Asset, name: str) -> Accessors:
    """The accessors of an asset in its current state."""
    binary = np.frombuffer(bytes(asset.binary), np.uint8)
    return Accessors(GltfDocument(name, Path(), Fields(asset.json, f"{name}:"), [binary]))


def _unit(
    normals: NDArray[np.float64], positions: NDArray[np.float64], faces: NDArray[np.integer], sign: float
) -> NDArray[np.float64]:
    """Unit normals. A zero normal is replaced by that of one of the vertex's faces, or by up."""
    length = np.linalg.norm(normals, axis=1)
    bad = ~(np.isfinite(length) & (length > 0.0))
    if bad.any():
        of_face, normals = face_vectors(positions, faces) * sign, normals.copy()
        normals[bad] = (0.0, 1.0, 0.0)
        solid = np.linalg.norm(of_face, axis=1) > 0.0
        for k in range(3):
            use = solid & bad[faces[:, k]]
            normals[faces[use, k]] = of_face[use]
        length = np.linalg.norm(normals, axis=1)
    return np.asarray(normals / length[:, None])


def to_local(directions: NDArray[np.floating], part: NodePrimitive) -> NDArray[np.float32]:
    """World directions in the frame of the file's normals, unit."""
    local = product(directions, part.linear)
    unit = local / np.maximum(np.linalg.norm(local, axis=1, keepdims=True), 1e-30)
    return np.asarray(unit.astype(np.float32))


# --- Edits ------------------------------------------------------------------------------------------------------------


def unshared_primitives(asset: Asset, parts: Sequence[NodePrimitive]) -> list[Json]:
    """The JSON of each part's primitive, in a mesh that no other node uses.

    Since baked values differ between nodes, a mesh used by several nodes is duplicated: the first node keeps it, the
    others get copies, which share all accessors.
    """
    nodes, meshes = asset.json["nodes"], asset.json["meshes"]
    baked = list(dict.fromkeys(part.node for part in parts))
    others = {node.get("mesh") for i, node in enumerate(nodes) if i not in set(baked)}
    used_meshes: set[int] = set()
    for i in baked:
        mesh = nodes[i]["mesh"]
        if mesh in used_meshes or mesh in others:
            nodes[i]["mesh"] = asset.add("meshes", copy.deepcopy(meshes[mesh]))
        used_meshes.add(mesh)
    return [meshes[nodes[part.node]["mesh"]]["primitives"][part.place] for part in parts]


Key = TypeVar("Key", bound=Hashable)


def change_materials(
    asset: Asset, primitives: Sequence[Json], keys: Sequence[Key], change: Callable[[Json, Key], object]
) -> None:
    """Call ``change(material, key)`` for the material of each primitive.

    A material is changed once per key. It is copied if primitives outside `primitives`, or with another key, use it.
    """
    changed, baked_ids = dict[tuple[int | None, Key], int](), {id(primitive) for primitive in primitives}
    all_primitives = [primitive for mesh in asset.json["meshes"] for primitive in mesh["primitives"]]
    used_materials = {primitive.get("material") for primitive in all_primitives if id(primitive) not in baked_ids}
    for primitive, key in zip(primitives, keys):
        index = primitive.get("material")
        if (index, key) not in changed:
            if index is None:
                material_index = asset.add("materials", {})
            elif index in used_materials:
                material_index = asset.add("materials", copy.deepcopy(asset.json["materials"][index]))
            else:
                material_index = index
            changed[index, key] = material_index
            used_materials.add(index)
        primitive["material"] = changed[index, key]
    for (_, key), material_index in changed.items():
        change(asset.json["materials"][material_index], key)


def all_rows(part: NodePrimitive, values: NDArray[np.floating]) -> NDArray[np.float32]:
    """(row_count, c): values of the part's vertices at the rows of its accessors; 1 in rows that no face uses."""
    out = np.ones((part.row_count, values.shape[1]), np.float32)
    out[part.rows] = values
    return out


def write_colours(
    asset: Asset, accessors: Accessors, primitive: Json, colours: NDArray[np.floating], multiply: bool
) -> None:
    """Write COLOR_0 of a primitive: 16-bit linear RGB. The alpha of an existing COLOR_0 is preserved.

    colours : (rows, 1 or 3) float32 in [0, 1]
    multiply : multiply existing colours instead of replacing them
    """
    rgba = np.ones((len(colours), 4))
    index = primitive["attributes"].get("COLOR_0")
    if index is not None:
        existing = accessors.floats(index, "VEC3", "VEC4")
        rgba[:, 3 if not multiply else 0 : existing.shape[1]] = existing[:, 3 if not multiply else 0 :]
    rgba[:, :3] *= colours
    quantized = np.round(65535.0 * np.clip(rgba, 0.0, 1.0)).astype("<u2")
    primitive["attributes"]["COLOR_0"] = asset.accessor(quantized, normalized=True)


class Remapper:
    """Rewrites the attributes of primitives for new vertices; identical accessors are written once."""

    def __init__(self, asset: Asset, accessors: Accessors):
        self._asset, self._accessors = asset, accessors
        self._remapped_accessors: dict[tuple[int, bytes], int] = {}
        self._indices: dict[bytes, int] = {}

    def remap(self, primitive: Json, rows: NDArray[np.int64], faces: NDArray[np.integer]) -> None:
        """Set a primitive's vertices to `rows` ((v,) of its accessors) and its faces to `faces` ((f, 3) into them)."""
        key = rows.astype(np.int64).tobytes()
        for attributes in (primitive["attributes"], *primitive.get("targets", [])):
            for name, index in attributes.items():
                attributes[name] = self._remapped(index, rows, key, name == "POSITION")
        kind = "<u2" if len(rows) < 65535 else "<u4"
        indices = faces.reshape(-1).astype(kind)
        if indices.tobytes() not in self._indices:
            self._indices[indices.tobytes()] = self._asset.accessor(indices, indices=True)
        primitive["indices"] = self._indices[indices.tobytes()]
        primitive.pop("mode", None)

    def _remapped(self, index: int, rows: np.ndarray, key: bytes, bounds: bool) -> int:
        if (index, key) not in self._remapped_accessors:
            normalized = bool(self._asset.json["accessors"][index].get("normalized"))
            values = self._accessors.stored(index)[rows]
            accessor = self._asset.accessor(
                values[:, 0] if values.shape[1] == 1 else values, normalized=normalized, bounds=bounds
            )
            self._remapped_accessors[index, key] = accessor
        return self._remapped_accessors[index, key]
