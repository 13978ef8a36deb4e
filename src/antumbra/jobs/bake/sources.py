"""The glTF file that a bake edits: the input itself, or one that is made of another scene."""

import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from ...loading import GLTF_SUFFIXES, load
from ...scene.any_scene import AnyScene
from ...scene.gltf.accessors import Accessors
from ...scene.gltf.document import open_document
from ...scene.scene import Scene
from .asset import Asset, open_asset

_INSTANCING = "EXT_mesh_gpu_instancing"
_PROPERTIES = {"TRANSLATION": ("VEC3", "translation"), "ROTATION": ("VEC4", "rotation"), "SCALE": ("VEC3", "scale")}
_UPRIGHT = [-(0.5**0.5), 0.0, 0.0, 0.5**0.5]  # the rotation that turns +Z to +Y
_MOST_MATERIALS = 256


@contextmanager
def opened(scene, time: float, up: str = "y") -> Iterator[tuple[Scene, Asset]]:
    """A scene whose source is a glTF file, and that file to edit.

    scene : path, or Scene; anything but a glTF file is written as one first, as it is at `time`

    Raises
    ------
    InputError
        If the scene cannot be read, or is in a store.
    """
    path = None if isinstance(scene, AnyScene) else Path(scene)
    if path is not None and path.suffix.lower() in GLTF_SUFFIXES and up == "y":
        found: Any = load(path)  # a Scene: no store is a glTF file
        asset = open_asset(path)
        if not _has_copies(asset):
            yield found, asset
            return
        _give_nodes(asset, path)
    else:
        found = scene if path is None else load(path, up=up)
        if not isinstance(found, Scene):
            raise found.refusal()
        asset = asset_of(found, time)
    with tempfile.TemporaryDirectory(prefix="antumbra-") as folder:
        written = Path(folder) / f"{path.stem if path else found.name}.glb".replace("/", "-")
        written.write_bytes(asset.glb())
        found = load(written)
        yield found, asset


def asset_of(scene: Scene, time: float) -> Asset:
    """A scene in memory as glTF: its triangles at a time, with their base colours. A scene with +Z up is turned."""
    asset = Asset({"asset": {"version": "2.0", "generator": "antumbra"}, "scene": 0, "buffers": [{}]}, bytearray())
    root: dict = {"name": scene.name, "translation": scene.origin.tolist(), "children": []}
    nodes = [asset.add("nodes", root)]
    if scene.up == "z":
        nodes = [asset.add("nodes", {"name": "upright", "rotation": _UPRIGHT, "children": nodes})]
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
    document = open_document(path)
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
    for key in ("extensionsUsed", "extensionsRequired"):
        if key in asset.json:
            asset.json[key] = [name for name in asset.json[key] if name != _INSTANCING]
            if not asset.json[key]:
                del asset.json[key]
