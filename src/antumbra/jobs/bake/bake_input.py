"""The checked arguments of a bake, and its input: the scene to measure, and the glTF file to edit.

The file is the input itself, or a new one created from any other kind of scene.
"""

import os
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple, cast

import numpy as np
from numpy.typing import NDArray

from ...checks import choice, flag, is_number, number, quoted, text, whole_number
from ...engine.paged_scene import PagedScene
from ...engine.plan import DEFAULT_PLAN, Plan, parse_plan
from ...engine.scene import AnyScene, Scene
from ...engine.scene_loading import SceneLike, load
from ...errors import InputError
from ...extras import import_extra
from ...files import checked_output, temporary_folder
from ...formats.format_registry import GLB, GLTF, format_of
from ...formats.gltf.accessors import Accessors
from ...formats.gltf.gltf_asset import Asset, open_asset
from ...formats.gltf.gltf_file import open_gltf
from ...formats.gltf.gltf_writer import Json, up_axis_transform
from ...kernels.parallel import thread_count
from ...picture.image_files import automatic_exposure, checked_exposure
from ...query.light_samples import sample_sets
from ...scene.camera import axes
from ...scene.default_picture import sun
from ...scene.light_lists import without_interleave
from ...scene.lights import AmbientOcclusion, DirectionalLight, Light, check_lights
from ...scene.mesh import Piece
from .gltf_primitives import NodePrimitive, read_primitives
from .surface_meter import QUANTITIES, MeterSettings

# --- Arguments --------------------------------------------------------------------------------------------------------


MAX_TEXTURE = 16384
_OWN_NAMES = {"ao": "_AO", "shadow": "_SHADOW", "sun": "_SUN", "light": "_LIGHT", "bent-normal": "_BENT_NORMAL"}
_SKY = ("ao", "bent-normal")  # quantities that depend on the sky instead of lights


class BakeOptions(NamedTuple):
    """Checked arguments of `bake`."""

    settings: MeterSettings
    attribute: str
    multiply: bool
    texture: int | None
    uv: int | None
    bits: int
    exr: bool
    denoise: bool
    exposure: float | None
    keep_hidden: bool


def default_bake_lights(scene: Scene, what: str, time: float) -> list[Light]:
    """The default lights of a scene; for the quantity "sun", its first sun, or that of default pictures."""
    lights = [without_interleave(light) for light in scene.default_lights(time)]
    if what != "sun":
        return lights
    return [next((light for light in lights if isinstance(light, DirectionalLight)), sun(scene.up))]


def exposure_of(values: NDArray[np.float32], options: BakeOptions) -> float:
    """The factor on light, from the measured values ((n, c), NaN for hidden points)."""
    if options.exposure is not None:
        return options.exposure
    if options.settings.what != "light":
        return 1.0
    return automatic_exposure(values[None], np.isfinite(values[None, :, 0]))


def check_output(path: str | os.PathLike[str]) -> Path:
    """`path`, if a bake can be written there; otherwise an InputError with a remedy."""
    return checked_output(path, GLB.suffixes)


def check_options(
    what: str, *, lights: Sequence[Light] | Light | None, radius: float | None, spp: int, attribute: str | None,
    multiply: bool, texture: int | None, uv: int | None, bits: int, exr: bool, denoise: bool, exposure: float | None,
    keep_hidden: bool, time: float, plan: str | Plan | None, sampler: str, threads: int | None,
) -> BakeOptions:  # fmt: skip
    """Check the arguments of `bake` as far as possible without a scene. Raises InputError."""
    choice(what, "what", QUANTITIES)
    thread_count(threads)
    time = number(time, "time (seconds)", -np.inf, np.inf, "[]")
    flags = {"multiply": multiply, "exr": exr, "denoise": denoise, "keep_hidden": keep_hidden}
    multiply, exr, denoise, keep_hidden = (flag(value, name) for name, value in flags.items())
    if attribute is not None:
        text(attribute, "attribute")
    parse_plan(DEFAULT_PLAN if plan is None else plan)
    sample_sets(whole_number(spp, "spp", 1, 1024), sampler)
    checked_lights = _checked_lights(what, lights, radius)
    if not is_number(bits) or bits not in (8, 16):
        raise InputError(f"bits is {quoted(bits)}; a PNG has 8 or 16")
    if texture is not None:
        whole_number(texture, "texture", 16, MAX_TEXTURE)
        if attribute is not None or multiply:
            raise InputError("attribute and multiply belong to values at vertices; leave them or texture out")
        if uv is None:
            import_extra("xatlas", "an atlas (--texture without --uv)", "bake")
    elif uv is not None or exr or denoise or bits != 8:
        raise InputError("uv, bits, exr and denoise belong to a texture; give its size as texture")
    if uv is not None:
        whole_number(uv, "uv", 0, 7)
    if denoise and what not in ("ao", "shadow"):
        raise InputError(f"denoise is for ao and shadow, not for {what}; leave it out and raise spp")
    attribute = attribute or ("_BENT_NORMAL" if what == "bent-normal" else "COLOR_0")
    if attribute != "COLOR_0" and not (attribute.startswith("_") and attribute.isascii() and attribute[1:]):
        raise InputError(f"attribute is {attribute!r}; write COLOR_0, or a name of your own such as {_OWN_NAMES[what]}")
    if multiply and attribute != "COLOR_0":
        raise InputError("multiply is for COLOR_0; leave it or attribute out")
    if exposure is not None:
        exposure = checked_exposure(exposure)
    settings = MeterSettings(what, checked_lights, spp, sampler, plan, time, threads)
    return BakeOptions(settings, attribute, multiply, texture, uv, bits, exr, denoise, exposure, keep_hidden)


def _checked_lights(what: str, lights: Sequence[Light] | Light | None, radius: float | None) -> list[Light]:
    if what in _SKY:
        if lights is not None:
            raise InputError(f"{what} depends on the sky, not on lights; leave lights out")
        return [AmbientOcclusion(None if radius is None else number(radius, "radius", 0.0, np.inf, "(]"))]
    if radius is not None:
        raise InputError(f"radius is for ao and bent-normal, not for {what}; leave it out")
    lights = [] if lights is None else check_lights(lights, "y")  # a `Sky` among them is rejected below
    if any(light.domain == "list" for light in lights):
        raise InputError("a bake takes lights one by one; PointLights is a list of them")
    if what == "sun" and lights and not (len(lights) == 1 and isinstance(lights[0], DirectionalLight)):
        raise InputError("sun takes one DirectionalLight; for several lights bake light")
    if what == "shadow" and any(light.domain == "hemisphere" for light in lights):
        raise InputError("a sky casts no shadow of its own; bake ao, or light")
    return lights


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
    loaded = load(scene, up=up)
    return BakeSource(loaded, Path(scene) if isinstance(scene, (str, os.PathLike)) and is_gltf(Path(scene)) else None)


def is_gltf(path: Path) -> bool:
    """Whether a file is glTF, so that a bake preserves its contents."""
    return format_of(path) in (GLB, GLTF)


def open_source(source: BakeSource, time: float) -> BakeScene:
    """The file to edit, and its parts at a time. A scene from another source is converted to glTF first.

    Raises
    ------
    InputError
        If the file cannot be read, or the scene is in a store.
    """
    file, scene = source.file, source.scene
    if not isinstance(scene, Scene):
        raise cast(PagedScene, scene).refusal()
    if file is None:
        asset = scene_to_asset(scene, time)
        parts = read_primitives(_scene_of_asset(asset, scene.name), asset, time)
        return BakeScene(
            scene, asset, parts if scene.up == "y" else [_in_scene_frame(part, axes(scene.up)) for part in parts]
        )
    asset, read = open_asset(file), scene
    if _has_instancing(asset):
        _expand_instances(asset, file)
        read = _scene_of_asset(asset, scene.name)
    return BakeScene(scene, asset, read_primitives(read, asset, time))


def _scene_of_asset(asset: Asset, name: str) -> Scene:
    """The scene of an asset, whose faces are those of its primitives."""
    with temporary_folder() as folder:
        path = folder / f"{name}.glb".replace("/", "-")
        path.write_bytes(asset.glb())
        return cast(Scene, load(path, up="y"))  # a glTF file is not a store


def _in_scene_frame(part: NodePrimitive, frame: np.ndarray) -> NodePrimitive:
    """A part in the frame of a scene whose right, up and backward axes are the rows of `frame`."""
    positions, normals = part.positions @ frame, part.normals @ frame
    return part._replace(positions=positions, normals=normals, linear=frame.T @ part.linear)


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
