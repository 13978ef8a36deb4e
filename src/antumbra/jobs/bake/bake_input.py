"""The input of a bake: the scene to measure, with its lights, and the glTF file to edit.

The file is the input itself, or a new one created from any other kind of scene.
"""

import os
from pathlib import Path
from typing import NamedTuple, cast

import numpy as np
from numpy.typing import NDArray

from ...engine.scene import AnyScene, Scene
from ...engine.scene_loading import SceneLike, load
from ...files import temporary_folder
from ...formats.format_registry import GLB, GLTF, format_of
from ...formats.gltf.accessors import Accessors
from ...formats.gltf.gltf_asset import Asset, open_asset
from ...formats.gltf.gltf_file import open_gltf
from ...formats.gltf.gltf_writer import Json, up_axis_transform
from ...kernels.small_matrices import product
from ...picture.image_files import automatic_exposure
from ...scene.camera import axes
from ...scene.default_picture import sun
from ...scene.light_lists import without_interleave
from ...scene.lights import DirectionalLight, Light
from ...scene.mesh import Piece
from ..measured_scenes import measured_scene
from .bake_options import BakeOptions
from .gltf_primitives import NodePrimitive, read_primitives
from .surface_meter import MeterSettings

# --- Settings that depend on the scene ------------------------------------------------------------------------------


def default_bake_lights(scene: Scene, what: str, time: float) -> list[Light]:
    """The default lights of a scene; for the quantity "sun", its first sun, or that of default pictures."""
    lights = [without_interleave(light) for light in scene.default_lights(time)]
    if what != "sun":
        return lights
    return [next((light for light in lights if isinstance(light, DirectionalLight)), sun(scene.up))]


def meter_settings(options: BakeOptions, scene: Scene) -> MeterSettings:
    """The settings of the measurement, with the scene's default lights if there are no others."""
    what, time = options.what, options.time
    lights = options.measured_lights() or default_bake_lights(scene, what, time)
    return MeterSettings(what, lights, options.spp, options.sampler, options.plan, time, options.threads)


def exposure_of(values: NDArray[np.float32], options: BakeOptions) -> float:
    """The factor on light, from the measured values ((n, c), NaN for hidden points)."""
    if options.exposure is not None:
        return options.exposure
    if options.what != "light":
        return 1.0
    return automatic_exposure(values[None], np.isfinite(values[None, :, 0]))


# --- The scene and its glTF file --------------------------------------------------------------------------------------


_INSTANCING = "EXT_mesh_gpu_instancing"
_PROPERTIES = {"TRANSLATION": ("VEC3", "translation"), "ROTATION": ("VEC4", "rotation"), "SCALE": ("VEC3", "scale")}
_MOST_MATERIALS = 256


class BakeSource(NamedTuple):
    """A scene to bake, and the glTF file that it comes from."""

    scene: AnyScene
    file: Path | None  # its contents are preserved; None: a file is created from the scene


class BakeScene(NamedTuple):
    """A scene, and its glTF file to edit."""

    scene: Scene  # the original scene: all rays are traced in it, so lights are in its frame
    asset: Asset
    parts: list[NodePrimitive]  # of the asset, in the frame of the scene


def bake_source(scene: SceneLike, up: str | None = None) -> BakeSource:
    """A scene, or the scene of a path or mesh. Raises InputError if it cannot be read."""
    if isinstance(scene, AnyScene):
        return BakeSource(scene, None)
    loaded = load(scene, up=up, instances=False)  # a bake writes every copy
    return BakeSource(loaded, Path(scene) if isinstance(scene, (str, os.PathLike)) and is_gltf(Path(scene)) else None)


def is_gltf(path: Path) -> bool:
    """Whether a file is glTF, so that a bake preserves its contents."""
    return format_of(path) in (GLB, GLTF)


def open_source(source: BakeSource, time: float) -> BakeScene:
    """The file to edit, and its parts at a time. A scene from another source is converted to glTF first.

    Raises
    ------
    InputError
        If the file cannot be read, the scene is in a store, or its coordinates are no lengths.
    """
    file, scene = source.file, measured_scene(source.scene)
    if not isinstance(scene, Scene):
        raise scene.refusal()
    if file is None:
        asset = scene_to_asset(scene, time)
        parts = read_primitives(_scene_of_asset(asset, scene.name), asset, time)
        _scale_to_metres(asset, scene.unit.metres)
        return BakeScene(
            scene, asset, parts if scene.up == "y" else [_in_scene_frame(part, axes(scene.up)) for part in parts]
        )
    asset, read = open_asset(file), scene
    if _has_instancing(asset):
        _expand_instances(asset, file)
        read = _scene_of_asset(asset, scene.name)
    return BakeScene(scene, asset, read_primitives(read, asset, time))


def _scale_to_metres(asset: Asset, metres: float) -> None:
    """Put the nodes of a file under one that scales them from a unit to metres, which glTF prescribes."""
    scene = asset.json["scenes"][0]
    if metres != 1.0:
        roots, scene["nodes"] = scene["nodes"], []
        asset.add_root({"name": "metres", "scale": [metres] * 3, "children": roots})


def _scene_of_asset(asset: Asset, name: str) -> Scene:
    """The scene of an asset, whose faces are those of its primitives."""
    with temporary_folder() as folder:
        path = folder / f"{name}.glb".replace("/", "-")
        path.write_bytes(asset.glb())
        return cast(Scene, load(path, up="y", instances=False))  # a glTF file is not a store


def _in_scene_frame(part: NodePrimitive, frame: np.ndarray) -> NodePrimitive:
    """A part in the frame of a scene whose right, up and backward axes are the rows of `frame`."""
    positions, normals = product(part.positions, frame), product(part.normals, frame)
    return part._replace(positions=positions, normals=normals, linear=product(frame.T, part.linear))


def scene_to_asset(scene: Scene, time: float) -> Asset:
    """A scene in memory as glTF: its triangles at a time, with base colours. A scene with +Z up is rotated."""
    asset = Asset()
    root: Json = {"name": scene.name, "translation": scene.origin.tolist(), "children": []}
    if scene.up == "z":
        asset.add_root({"name": "upright", "children": [asset.add("nodes", root)], **up_axis_transform(scene.up)})
    else:
        asset.add_root(root)
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


def _primitives(
    asset: Asset, vertices: np.ndarray, faces: np.ndarray, piece: Piece, materials: dict[bytes, int]
) -> list[Json]:
    """A primitive for each colour of a piece."""
    colours = np.broadcast_to(piece.colour, (len(faces), 3))
    kinds, of_face = np.unique(colours, axis=0, return_inverse=True)
    of_face = of_face.reshape(-1)
    if len(kinds) > _MOST_MATERIALS:  # vertex colours instead; a vertex with several colours is duplicated
        keys, corners = np.unique(faces.astype(np.int64) * len(kinds) + of_face[:, None], return_inverse=True)
        colours, white = kinds[keys % len(kinds)], _material(asset, np.ones(3), materials)
        return [asset.primitive(vertices[keys // len(kinds)], corners, colours, material=white)]
    primitives = []
    for k, colour in enumerate(kinds):
        used, corners = np.unique(faces[of_face == k], return_inverse=True)
        primitives.append(asset.primitive(vertices[used], corners, material=_material(asset, colour, materials)))
    return primitives


def _material(asset: Asset, colour: np.ndarray, materials: dict[bytes, int]) -> int:
    """The index of the material of a colour, which is added if `materials` lacks it."""
    key = np.asarray(colour, np.float32).tobytes()
    if key not in materials:
        model = {"baseColorFactor": [*map(float, colour), 1.0], "metallicFactor": 0.0}
        materials[key] = asset.add("materials", {"pbrMetallicRoughness": model, "doubleSided": True})
    return materials[key]


def _has_instancing(asset: Asset) -> bool:
    return any(_INSTANCING in node.get("extensions", {}) for node in asset.json.get("nodes", []))


def _expand_instances(asset: Asset, path: Path) -> None:
    """Replace EXT_mesh_gpu_instancing by nodes: its instances share all attributes, but baked values differ."""
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
