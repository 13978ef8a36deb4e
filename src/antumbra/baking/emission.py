"""The light that the materials of a glTF file emit, per face: bakes of bounced light gather it."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..engine.scene import Scene
from ..formats.gltf.accessors import Accessors
from ..formats.gltf.gltf_asset import Asset, image_of_texture
from ..formats.gltf.gltf_materials import EMISSIVE_STRENGTH, WRAPS
from ..formats.gltf.gltf_source import PlacedPrimitive
from ..formats.gltf.gltf_writer import Json
from ..scene.materials import REPEAT, Texture, texture_means
from .base_colours import transformed_coordinates, uv_set_of
from .gltf_primitives import accessors_of, primitive_json


def emitted_radiance(scene: Scene, asset: Asset, time: float) -> tuple[NDArray[np.float32] | None, list[str]]:
    """The radiance of each face of a scene, and notes on textures that cannot be read.

    Returns
    -------
    (n, 3) float32 or None
        In nits (cd/m2, as glTF has it), linear RGB: the emissive factor times its strength, times the mean of the
        emissive texture over the face. None: no face emits light.
    list of str
    """
    accessors, rows, notes = accessors_of(asset, scene.name), list[NDArray[np.float32]](), list[str]()
    source: Any = scene.source  # of a glTF file
    textures: dict[tuple[int, int, int], Texture] = {}
    for placed in source.placed(scene.clamped(time)):
        count = placed.primitive.triangles * len(placed.vertices)
        json = primitive_json(asset, placed)
        material = {} if "material" not in json else asset.json["materials"][json["material"]]
        strength = material.get("extensions", {}).get(EMISSIVE_STRENGTH, {}).get("emissiveStrength", 1.0)
        factor = strength * np.array(material.get("emissiveFactor", (0, 0, 0)), np.float64)
        radiance = np.broadcast_to(factor, (count, 3))
        if "emissiveTexture" in material and factor.any():
            try:
                of_faces = _texture_colours(asset, accessors, json, placed, material["emissiveTexture"], textures)
                radiance = factor * np.tile(of_faces, (len(placed.vertices), 1))
            except (ValueError, KeyError):
                notes.append(f"{placed.primitive.where}: its emissive texture cannot be read; it emits evenly")
        rows.append(radiance.astype(np.float32))
    emission = np.concatenate(rows) if rows else np.zeros((0, 3), np.float32)
    return (emission if emission.any() else None), notes


def _texture_colours(
    asset: Asset,
    accessors: Accessors,
    json: Json,
    placed: PlacedPrimitive,
    info: Json,
    textures: dict[tuple[int, int, int], Texture],
) -> NDArray[np.float32]:
    """(f, 3) float32: the mean colour of a texture on each face of a primitive. Raises ValueError or KeyError.

    textures : the textures of the file that were read before, by image and wrap modes; they are decoded once
    """
    texture = _texture(asset, asset.json["textures"][info["index"]], textures)
    uv = transformed_coordinates(accessors.finite(json["attributes"][uv_set_of(info)], "VEC2"), info)
    primitive = placed.primitive
    uv = uv if primitive.used is None else uv[primitive.used]
    corners = uv.reshape(-1, 3, 2) if primitive.mesh.faces is None else uv[primitive.mesh.faces]
    return texture_means(texture, corners)


def _texture(asset: Asset, fields: Json, textures: dict[tuple[int, int, int], Texture]) -> Texture:
    index = image_of_texture(fields)
    sampler = asset.json["samplers"][fields["sampler"]] if "sampler" in fields else {}
    wrap_s, wrap_t = (WRAPS.get(sampler.get(name, 0), REPEAT) for name in ("wrapS", "wrapT"))
    if index is None or (data := asset.image_bytes(index)) is None:
        raise ValueError("no image")
    return textures.setdefault((index, wrap_s, wrap_t), Texture("emissiveTexture", data, wrap_s, wrap_t))
