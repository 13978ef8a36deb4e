"""What a bake measures, and the glTF file that it edits: the input itself, or one that is made of another scene."""

import os
from pathlib import Path
from typing import Any, NamedTuple, cast

import numpy as np

from ...engine.paged_scene import PagedScene
from ...engine.scene import AnyScene, Scene
from ...engine.scene_loading import load
from ...engine.scene_reading import GLTF_SUFFIXES
from ...files import temporary_folder
from ...formats.gltf.accessors import Accessors
from ...formats.gltf.gltf_file import open_gltf, up_axis_transform
from ...scene.camera import axes
from .asset import Asset, open_asset
from .parts import Part, read_parts

_INSTANCING = "EXT_mesh_gpu_instancing"
_PROPERTIES = {"TRANSLATION": ("VEC3", "translation"), "ROTATION": ("VEC4", "rotation"), "SCALE": ("VEC3", "scale")}
_MOST_MATERIALS = 256


class Given(NamedTuple):
    """A scene to bake, and the glTF file that it comes from."""

    scene: AnyScene
    file: Path | None  # whose contents the bake keeps; None: a file is made of the scene


class Opened(NamedTuple):
    """A scene, and a glTF file of it to edit."""

    scene: Scene  # as it was given: all rays are traced in it, so lights are those of its frame
    asset: Asset
    parts: list[Part]  # of the asset, in the frame of the scene


def given(scene, up: str | None = None) -> Given:
    """A scene, or the scene of a path or mesh. Raises InputError if it cannot be read."""
    if isinstance(scene, AnyScene):
        return Given(scene, None)
    found = load(scene, up=up)
    return Given(found, Path(scene) if isinstance(scene, (str, os.PathLike)) and is_gltf(Path(scene)) else None)


def is_gltf(path: Path) -> bool:
    """Whether a file is glTF, whose contents a bake keeps."""
    return path.suffix.lower() in GLTF_SUFFIXES


def opened(source: Given, time: float) -> Opened:
    """The file to edit, and its parts at a time. A scene that is no glTF file is written as one first.

    Raises
    ------
    InputError
        If the file cannot be read, or the scene is in a store.
    """
    file, scene = source.file, source.scene
    if not isinstance(scene, Scene):
        raise cast(PagedScene, scene).refusal()
    if file is None:
        asset = asset_of(scene, time)
        parts = read_parts(_read_again(asset, scene.name), asset, time)
        return Opened(scene, asset, parts if scene.up == "y" else [_turned(part, axes(scene.up)) for part in parts])
    asset, read = open_asset(file), scene
    if _has_copies(asset):
        _give_nodes(asset, file)
        read = _read_again(asset, scene.name)
    return Opened(scene, asset, read_parts(read, asset, time))


def _read_again(asset: Asset, name: str) -> Scene:
    """The scene of an asset, whose faces are those of its primitives."""
    with temporary_folder() as folder:
        written = folder / f"{name}.glb".replace("/", "-")
        written.write_bytes(asset.glb())
        found: Any = load(written, up="y")  # a Scene: no store is a glTF file
        return found


def _turned(part: Part, frame: np.ndarray) -> Part:
    """A part in the frame of a scene whose right, up and backward axes are the rows of `frame`."""
    return part._replace(
        positions=part.positions @ frame, normals=part.normals @ frame, linear=frame.T @ part.linear
    )  # fmt: skip


def asset_of(scene: Scene, time: float) -> Asset:
    """A scene in memory as glTF: its triangles at a time, with their base colours. A scene with +Z up is turned."""
    asset = Asset({"asset": {"version": "2.0", "generator": "antumbra"}, "scene": 0, "buffers": [{}]}, bytearray())
    root: dict = {"name": scene.name, "translation": scene.origin.tolist(), "children": []}
    nodes = [asset.add("nodes", root)]
    if scene.up == "z":
        nodes = [asset.add("nodes", {"name": "upright", "children": nodes, **up_axis_transform(scene.up)})]
    asset.json["scenes"] = [{"nodes": nodes}]
    materials: dict[bytes, int] = {}
    for piece in scene.source.pieces(scene.clamped(time)):
        vertices = (
            piece.vertices
            if piece.towards is None
            else ((1.0 - piece.share) * piece.vertices + piece.share * piece.towards)
        )
        for copy in vertices:
            local = (copy.astype(np.float64) - scene.origin).astype(np.float32)
            faces = np.arange(len(local)).reshape(-1, 3) if piece.faces is None else piece.faces
            name = piece.where.rpartition('mesh "')[2].rstrip('"') or scene.name
            mesh = asset.add("meshes", {"name": name, "primitives": _primitives(asset, local, faces, piece, materials)})
            root["children"].append(asset.add("nodes", {"name": name, "mesh": mesh}))
    return asset


def _primitives(asset: Asset, vertices, faces, piece, materials) -> list[dict]:
    """A primitive for each colour of a piece."""
    colours = np.broadcast_to(piece.colour, (len(faces), 3))
    kinds, of_face = np.unique(colours, axis=0, return_inverse=True)
    of_face = of_face.reshape(-1)
    if len(kinds) > _MOST_MATERIALS:  # a colour for each vertex; a vertex with several colours is divided
        keys, corners = np.unique(faces.astype(np.int64) * len(kinds) + of_face[:, None], return_inverse=True)
        position = asset.accessor(vertices[keys // len(kinds)], bounds=True)
        colour = asset.accessor(kinds[keys % len(kinds)].astype(np.float32))
        attributes = {"POSITION": position, "COLOR_0": colour}
        return [_primitive(asset, attributes, corners.reshape(-1, 3), np.ones(3, np.float32), materials)]
    found = []
    for k, colour in enumerate(kinds):
        used, corners = np.unique(faces[of_face == k], return_inverse=True)
        attributes = {"POSITION": asset.accessor(vertices[used], bounds=True)}
        found.append(_primitive(asset, attributes, corners.reshape(-1, 3), colour, materials))
    return found


def _primitive(asset: Asset, attributes: dict, faces, colour, materials: dict[bytes, int]) -> dict:
    key = np.asarray(colour, np.float32).tobytes()
    if key not in materials:
        model = {"baseColorFactor": [*map(float, colour), 1.0], "metallicFactor": 0.0}
        materials[key] = asset.add("materials", {"pbrMetallicRoughness": model, "doubleSided": True})
    indices = asset.accessor(faces.reshape(-1).astype("<u4"), indices=True)
    return {"attributes": attributes, "indices": indices, "material": materials[key]}


def _has_copies(asset: Asset) -> bool:
    return any(_INSTANCING in node.get("extensions", {}) for node in asset.json.get("nodes", []))


def _give_nodes(asset: Asset, path: Path) -> None:
    """Replace the copies of EXT_mesh_gpu_instancing by nodes: copies share all attributes, and bakes differ."""
    document = open_gltf(path)
    accessors = Accessors(document)
    for node in list(asset.json["nodes"]):
        extension = node.get("extensions", {}).pop(_INSTANCING, None)
        if extension is None or "mesh" not in node:
            continue
        values = {
            key: accessors.finite(extension["attributes"][name], kind)
            for name, (kind, key) in _PROPERTIES.items()
            if name in extension["attributes"]
        }
        for k in range(len(next(iter(values.values())))):
            one = {"mesh": node["mesh"], **{key: rows[k].tolist() for key, rows in values.items()}}
            node.setdefault("children", []).append(asset.add("nodes", one))
        del node["mesh"]
        if not node["extensions"]:
            del node["extensions"]
    asset.uses_no_more(_INSTANCING)
