"""The input of a bake: the scene to measure, with its lights, and the glTF file to edit.

The file is the input itself, or a new one created from any other kind of scene.
"""

import os
from pathlib import Path
from typing import Any, NamedTuple, cast

import numpy as np
from numpy.typing import NDArray

from ..base.files import temporary_folder
from ..base.wording import counted
from ..engine.measured_scenes import measured_scene
from ..engine.scene import AnyScene, Scene
from ..engine.scene_loading import SceneLike, load
from ..formats.example_files import scene_path
from ..formats.format_registry import GLB, GLTF, format_of
from ..formats.gltf.accessors import Accessors
from ..formats.gltf.gltf_asset import Asset, open_asset
from ..formats.gltf.gltf_file import open_gltf
from ..kernels.small_matrices import product
from ..picture.image_files import automatic_exposure
from ..scene.camera import axes
from ..scene.light_lists import without_interleave
from ..scene.lights import DirectionalLight, Light
from .bake_options import BakeOptions
from .converted_scenes import scene_to_asset
from .emission import emitted_radiance
from .gltf_primitives import NodePrimitive, primitive_json, read_primitives
from .surface_meter import MeterSettings

# --- Settings that depend on the scene ------------------------------------------------------------------------------


def default_bake_lights(scene: Scene, what: str, time: float) -> list[Light]:
    """The default lights of a scene; for the quantity "sun", its first sun, or that of default pictures."""
    lights = [without_interleave(light) for light in scene.default_lights(time)]
    if what != "sun":
        return lights
    return [next((light for light in lights if isinstance(light, DirectionalLight)), scene.view.sun())]


def meter_settings(options: BakeOptions, scene: Scene) -> MeterSettings:
    """The settings of the measurement, with the scene's default lights if there are no others."""
    what, time = options.what, options.time
    lights = options.measured_lights() or default_bake_lights(scene, what, time)
    drawn = [light.drawn(options.seed) for light in lights]
    separate = options.denoise and what == "light"
    return MeterSettings(
        what, drawn, options.spp, options.sampler, options.plan, time, options.threads, options.seed, options.bounces,
        separate,
    )  # fmt: skip


_HEADROOM = 2.0
"""The range of a lightmap, relative to that of a picture: viewers expose again, but 8 bits show steps in the dark."""


def exposure_of(values: NDArray[np.float32], options: BakeOptions) -> float:
    """The factor on light, from the measured values, (n, c)."""
    if options.exposure is not None:
        return options.exposure
    if options.what != "light":
        return 1.0
    exposure = automatic_exposure(values[None], np.ones((1, len(values)), bool))
    if not options.makes_lightmap:
        return exposure
    return max(exposure / _HEADROOM, 1.0 / max(float(np.percentile(values.max(-1), 99.9)), 1e-6))


# --- The scene and its glTF file --------------------------------------------------------------------------------------


_INSTANCING = "EXT_mesh_gpu_instancing"
_PROPERTIES = {"TRANSLATION": ("VEC3", "translation"), "ROTATION": ("VEC4", "rotation"), "SCALE": ("VEC3", "scale")}


class BakeSource(NamedTuple):
    """A scene to bake, and the glTF file that it comes from."""

    scene: AnyScene
    file: Path | None  # its contents are preserved; None: a file is created from the scene


class BakeScene(NamedTuple):
    """A scene, and its glTF file to edit."""

    scene: Scene  # the original scene, or store: all rays are traced in it, so lights are in its frame
    asset: Asset
    parts: list[NodePrimitive]  # of the asset, in the frame of the scene
    double_sided: NDArray[np.bool_]  # (n,) bool: the faces of the scene whose material in the file is double-sided
    emission: NDArray[np.float32] | None  # (n, 3): radiance of the faces of the scene; None: none emits light
    is_new: bool  # the file is created from the scene, so its COLOR_0 are base colours
    notes: list[str]  # what the file loses
    faces: NDArray[np.integer] | None = None  # (f,): the faces of the scene that those of the parts are; None: in order


def bake_source(scene: SceneLike, up: str | None = None) -> BakeSource:
    """A scene, or the scene of a path or mesh. Raises InputError if it cannot be read."""
    if isinstance(scene, AnyScene):
        return BakeSource(scene, None)
    loaded = load(scene, up=up, instances=False)  # a bake writes every copy
    path = scene_path(scene) if isinstance(scene, (str, os.PathLike)) else None
    return BakeSource(loaded, path if path is not None and is_gltf(path) else None)


def is_gltf(path: Path) -> bool:
    """Whether a file is glTF, so that a bake preserves its contents."""
    return format_of(path) in (GLB, GLTF)


def open_source(source: BakeSource, time: float, emits: bool) -> BakeScene:
    """The file to edit, and its parts at a time. A scene from another source is converted to glTF first.

    emits : whether to read what its faces emit

    Raises
    ------
    InputError
        If the file cannot be read, the scene is in a store and does not fit in memory, or its coordinates are no
        lengths.
    """
    file, scene = source.file, cast(Scene, measured_scene(source.scene))
    if file is None:
        asset, faces = scene_to_asset(scene, time)
        parts = read_primitives(_scene_of_asset(asset, scene.name), asset, time)
        _scale_to_metres(asset, scene.unit.metres)
        parts = parts if scene.up == "y" else [_in_scene_frame(part, axes(scene.up)) for part in parts]
        double_sided = np.ones(scene.n_triangles, bool)  # as `_material` writes them
        return BakeScene(scene, asset, parts, double_sided, None, True, _conversion_notes(scene), faces)
    asset, read = open_asset(file), scene
    double_sided = _double_sided_faces(scene, asset, time)
    emission, notes = emitted_radiance(scene, asset, time) if emits else (None, list[str]())
    if _has_instancing(asset):
        _expand_instances(asset, file)
        read = _scene_of_asset(asset, scene.name, getattr(scene.source, "animation", None))
    return BakeScene(scene, asset, read_primitives(read, asset, time), double_sided, emission, False, notes)


def _conversion_notes(scene: Scene) -> list[str]:
    """What a scene loses when it becomes a new glTF file."""
    looks, notes = scene.data.stored_looks or scene.appearance, list[str]()
    n = 0 if looks is None else len({each.texture for each in looks.materials} - {None})
    if n:
        notes.append(
            f"{scene.name}: {counted(n, 'texture', 'become')} the mean colours of faces; to keep textures, bake the "
            "path of a glTF file"
        )
    if not scene.data.resident:
        notes.append(
            f"{scene.name}: corners of a store that lie at one place become one vertex, so values are smooth across "
            "edges; for hard edges, bake the source file"
        )
    return notes


def _double_sided_faces(scene: Scene, asset: Asset, time: float) -> NDArray[np.bool_]:
    """(n,) bool: the faces of a scene whose material in its glTF file is double-sided."""
    materials, counts, flags = asset.json.get("materials", []), list[int](), list[bool]()
    source: Any = scene.source  # of a glTF file
    for placed in source.placed(scene.clamped(time)):
        material = primitive_json(asset, placed).get("material")
        counts.append(placed.primitive.triangles * len(placed.vertices))
        flags.append(material is not None and bool(materials[material].get("doubleSided")))
    return np.repeat(np.array(flags, bool), counts)


def _scale_to_metres(asset: Asset, metres: float) -> None:
    """Put the nodes of a file under one that scales them from a unit to metres, which glTF prescribes."""
    scene = asset.json["scenes"][0]
    if metres != 1.0:
        roots, scene["nodes"] = scene["nodes"], []
        asset.add_root({"name": "metres", "scale": [metres] * 3, "children": roots})


def _scene_of_asset(asset: Asset, name: str, animation: str | None = None) -> Scene:
    """The scene of an asset, whose faces are those of its primitives."""
    with temporary_folder() as folder:
        path = folder / f"{name}.glb".replace("/", "-")
        path.write_bytes(asset.glb())
        return cast(Scene, load(path, up="y", instances=False, animation=animation))  # a glTF file is not a store


def _in_scene_frame(part: NodePrimitive, frame: np.ndarray) -> NodePrimitive:
    """A part in the frame of a scene whose right, up and backward axes are the rows of `frame`."""
    positions, normals = product(part.positions, frame), product(part.normals, frame)
    return part._replace(positions=positions, normals=normals, linear=product(frame.T, part.linear))


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
