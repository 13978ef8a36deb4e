"""A scene as a new glTF file, for a bake of what is not glTF: meshes with base colours, in memory or from a store."""

from collections.abc import Iterator
from typing import cast

import numpy as np
from numpy.typing import NDArray

from ..engine.scene import AnyScene
from ..formats.gltf.gltf_asset import Asset
from ..formats.gltf.gltf_writer import Json, up_axis_transform
from ..scene.appearance import normals_from_frames
from ..scene.mesh import Piece
from ..scene.scene_bounds import flush_to_zero
from ..scene.scene_data import MemoryData
from ..store.store_data import StoreData
from .stored_shapes import Shape, stored_shapes

_MOST_MATERIALS = 256


def scene_to_asset(scene: AnyScene, time: float) -> tuple[Asset, NDArray[np.integer]]:
    """A scene as glTF: its triangles at a time, with base colours and the normals of its vertices.

    A scene with +Z up is rotated. InputError if it is in a store, and does not fit in memory.

    Returns
    -------
    Asset
    (f,) int
        The face of the scene that each face of the file is. Faces are in the order of colours in each mesh.
    """
    asset = Asset()
    root: Json = {"name": scene.name, "translation": scene.origin.tolist(), "children": []}
    if scene.up == "z":
        asset.add_root({"name": "upright", "children": [asset.add("nodes", root)], **up_axis_transform(scene.up)})
    else:
        asset.add_root(root)
    materials, numbers = dict[bytes, int](), list[NDArray[np.integer]]()
    shapes = stored_shapes(scene) if isinstance(scene.data, StoreData) else _shapes(scene, time)
    for name, shape in shapes:
        parts = list(_parts(shape))
        primitives = [_primitive(asset, part, materials) for part in parts]
        numbers += [part.numbers for part in parts]
        mesh = asset.add("meshes", {"name": name, "primitives": primitives})
        root["children"].append(asset.add("nodes", {"name": name, "mesh": mesh}))
    return asset, np.concatenate([np.empty(0, np.int64), *numbers])


def _shapes(scene: AnyScene, time: float) -> Iterator[tuple[str, Shape]]:
    """Yield the name and the shape of each copy of a mesh of a scene in memory."""
    first, frames = 0, None if scene.appearance is None else scene.appearance.normals
    for piece in cast(MemoryData, scene.data).source.pieces(scene.clamped(time)):
        vertices = (
            piece.vertices
            if piece.towards is None
            else ((1.0 - piece.share) * piece.vertices + piece.share * piece.towards)
        )
        for copy in vertices:
            faces = np.arange(len(copy)).reshape(-1, 3) if piece.faces is None else piece.faces
            rows = slice(first, first + len(faces))
            shape = Shape(
                flush_to_zero((copy.astype(np.float64) - scene.origin).astype(np.float32)),
                faces,
                _normals_of(piece, copy, faces, None if frames is None else frames[rows]),
                np.broadcast_to(piece.colour, (len(faces), 3)),
                np.arange(rows.start, rows.stop),
            )
            yield ("" if scene.city else piece.where.partition('mesh "')[2].rstrip('"')) or scene.name, shape
            first = rows.stop


def _normals_of(
    piece: Piece, vertices: np.ndarray, faces: NDArray[np.integer], frames: NDArray[np.float32] | None
) -> NDArray[np.float32] | None:
    """(v, 3) float32: unit normals of a copy's vertices; 0 where there is none. None: no vertex has one.

    frames : `Appearance.normals` of the copy's faces, which move with them
    """
    look = piece.look
    if frames is None or look is None or look.normals is None or look.rest_positions is None:
        return None
    if piece.linear is None and np.array_equal(vertices, look.rest_positions):
        normals = look.normals.astype(np.float64)
    else:  # the mean over the corners at a vertex, which agree where nothing bends
        corners, normals = normals_from_frames(vertices[faces].astype(np.float64), frames), np.zeros(vertices.shape)
        np.add.at(normals, faces.reshape(-1), corners.reshape(-1, 3))
    length = np.linalg.norm(normals, axis=1, keepdims=True)
    return np.asarray(normals / np.where(length > 0.0, length, 1.0), np.float32)


def _parts(shape: Shape) -> Iterator[Shape]:
    """Yield the parts of a shape that are primitives: those with normals, then those without, by their colours."""
    halves = [shape]
    if shape.normals is not None:
        has_normals = (shape.normals[shape.faces] != 0.0).any(2).all(1)
        halves = [shape.part(has_normals), shape.part(~has_normals)._replace(normals=None)]
    for half in halves:
        kinds, of_face = np.unique(half.colours, axis=0, return_inverse=True)
        if len(kinds) > _MOST_MATERIALS:
            yield half
            continue
        for k in range(len(kinds)):
            yield half.part(of_face.reshape(-1) == k)


def _primitive(asset: Asset, shape: Shape, materials: dict[bytes, int]) -> Json:
    """The primitive of a shape, which has one colour, or vertex colours."""
    if (shape.colours == shape.colours[:1]).all():
        material = _material(asset, shape.colours[0], materials)
        return asset.primitive(shape.vertices, shape.faces, normals=shape.normals, material=material)
    kinds, of_face = np.unique(shape.colours, axis=0, return_inverse=True)
    # A vertex with several colours is duplicated.
    numbers = shape.faces.astype(np.int64) * len(kinds) + of_face.reshape(-1)[:, None]
    keys, corners = np.unique(numbers, return_inverse=True)
    vertex, white = keys // len(kinds), _material(asset, np.ones(3), materials)
    normals = None if shape.normals is None else shape.normals[vertex]
    return asset.primitive(shape.vertices[vertex], corners, kinds[keys % len(kinds)], normals, material=white)


def _material(asset: Asset, colour: np.ndarray, materials: dict[bytes, int]) -> int:
    """The index of the material of a colour, which is added if `materials` lacks it."""
    key = np.asarray(colour, np.float32).tobytes()
    if key not in materials:
        model = {"baseColorFactor": [*map(float, colour), 1.0], "metallicFactor": 0.0}
        materials[key] = asset.add("materials", {"pbrMetallicRoughness": model, "doubleSided": True})
    return materials[key]
