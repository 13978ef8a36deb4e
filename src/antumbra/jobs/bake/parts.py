"""Parts of a scene: the primitives of a glTF file at their nodes, with world positions and normals."""

from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from ...engine.scene import Scene
from ...formats.gltf.accessors import Accessors
from ...formats.gltf.gltf_file import GltfDocument
from ...formats.json_fields import Fields
from .asset import Asset


class Part(NamedTuple):
    """A primitive at a node, as it is at the time of a bake."""

    node: int
    index: int  # type: ignore[assignment]  # of the primitive in its mesh
    where: str  # name in errors
    json: dict  # the primitive in the file
    rows: np.ndarray  # (v,) int64: rows of the accessors that its faces use, in order
    count: int  # type: ignore[assignment]  # rows of the accessors
    positions: np.ndarray  # (v, 3) float64, world
    normals: np.ndarray  # (v, 3) float64, unit, world
    faces: np.ndarray  # (f, 3) int32 into `positions`
    flat: bool  # no NORMAL in the file: viewers shade each face with its own normal
    linear: np.ndarray  # (3, 3) float64, the node's transform without its translation; 1 if a skin moves the part
    sign: float  # -1.0 if the node mirrors: then the file's corners run the other way round


def read_parts(scene: Scene, asset: Asset, time: float) -> list[Part]:
    """The parts of a scene whose source is a glTF file, in the order of its faces.

    asset : the same file
    """
    accessors = accessors_of(asset, scene.name)
    meshes, nodes = asset.json.get("meshes", []), asset.json.get("nodes", [])
    parts = []
    source: Any = scene.source  # of a glTF file
    for placed in source.placed(scene.clamped(time)):
        primitive, (positions,) = placed.primitive, placed.vertices
        json = meshes[nodes[placed.node]["mesh"]]["primitives"][primitive.place]
        count = asset.json["accessors"][json["attributes"]["POSITION"]]["count"]
        rows = np.arange(count) if primitive.used is None else np.flatnonzero(primitive.used)
        faces = primitive.mesh.faces
        faces = np.arange(len(rows), dtype=np.int32).reshape(-1, 3) if faces is None else faces
        moved = placed.skinned or primitive.targets is not None
        linear = np.eye(3) if placed.skinned else placed.matrix[:3, :3]
        sign = -1.0 if np.linalg.det(linear) < 0.0 else 1.0
        stored = json["attributes"].get("NORMAL")
        given = None if stored is None else accessors.floats(stored, "VEC3")[rows].astype(np.float64)
        if given is None or moved:
            keys = primitive.mesh.positions if given is None else np.concatenate([primitive.mesh.positions, given], 1)
            normals = smooth_normals(positions, faces, keys) * sign
        else:
            normals = given @ np.linalg.inv(linear)
        normals = _unit(normals, positions, faces, sign)
        parts.append(
            Part(
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


def accessors_of(asset: Asset, name: str) -> Accessors:
    """The accessors of an asset, as it is now."""

    binary = np.frombuffer(bytes(asset.binary), np.uint8)
    return Accessors(GltfDocument(name, Path(), Fields(asset.json, f"{name}:"), [binary]))


def face_vectors(positions: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """(f, 3) float64: the normals of faces, twice their area long."""
    a, b, c = (positions[faces[:, k]] for k in range(3))
    return np.cross(b - a, c - a)


def smooth_normals(positions: np.ndarray, faces: np.ndarray, keys: np.ndarray) -> np.ndarray:
    """(v, 3) float64: the mean of the faces around each vertex; vertices with equal keys are one.

    A face counts by its angle at the vertex. So it does not matter how a polygon is divided into triangles.
    """
    _, same = np.unique(np.ascontiguousarray(keys), axis=0, return_inverse=True)
    same, vectors = same.reshape(-1), face_vectors(positions, faces)
    vectors = vectors / np.maximum(np.linalg.norm(vectors, axis=1, keepdims=True), 1e-300)
    sums = np.zeros((int(same.max()) + 1, 3))
    for k in range(3):
        corner, weighted = same[faces[:, k]], _angles(positions, faces, k)[:, None] * vectors
        sums += np.stack([np.bincount(corner, weighted[:, i], len(sums)) for i in range(3)], 1)
    return sums[same]


def _angles(positions: np.ndarray, faces: np.ndarray, k: int) -> np.ndarray:
    """(f,) float64: the angle of each face at its corner k."""
    a, b, c = (positions[faces[:, (k + i) % 3]] for i in range(3))
    return np.arctan2(np.linalg.norm(np.cross(b - a, c - a), axis=1), ((b - a) * (c - a)).sum(1))


def _unit(normals: np.ndarray, positions: np.ndarray, faces: np.ndarray, sign: float) -> np.ndarray:
    """Unit normals. A vertex whose normal is zero has that of one of its faces, or up."""
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
    return normals / length[:, None]


def to_local(directions: np.ndarray, part: Part) -> np.ndarray:
    """World directions in the frame of the file's normals, unit."""
    local = directions @ part.linear
    return (local / np.maximum(np.linalg.norm(local, axis=1, keepdims=True), 1e-30)).astype(np.float32)
