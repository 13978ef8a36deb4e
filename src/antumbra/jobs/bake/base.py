"""The base colour textures of materials, at the texels of a sheet."""

import io
from collections.abc import Sequence

import numpy as np

from ...formats.gltf.accessors import Accessors
from ...formats.gltf.gltf_file import data_uri_bytes, is_data_uri
from ...scene.materials import BYTE_TO_LINEAR
from .asset import Asset
from .charts import Sheet, corners_of
from .textures import looked_up

_TRANSFORM = "KHR_texture_transform"


def base_texels(asset: Asset, accessors: Accessors, sheet: Sheet, primitives: Sequence[dict]) -> np.ndarray:
    """(n, 4) float32: linear base colour and alpha of the texels of the cover, without the materials' factors.

    primitives : JSON of each member of the sheet, as it was in the file
    """
    cover, out, start = sheet.cover, np.ones((len(sheet.cover.texel), 4), np.float32), 0
    images: dict[int, np.ndarray | None] = {}
    for one, primitive in zip(sheet.unwrapped, primitives):
        here = (cover.face >= start) & (cover.face < start + len(one.faces))
        start += len(one.faces)
        used = _base_texture(asset, primitive)
        if used is None or not here.any():
            continue
        source = asset.json["textures"][used["index"]].get("source")
        if source not in images:
            images[source] = None if source is None else _decoded(asset, asset.json["images"][source])
        name = f"TEXCOORD_{used.get('extensions', {}).get(_TRANSFORM, {}).get('texCoord', used.get('texCoord', 0))}"
        image = images[source]
        if image is None or name not in primitive["attributes"]:
            continue
        uv = accessors.finite(primitive["attributes"][name], "VEC2")[one.part.rows]
        corners = corners_of([one], [uv])[cover.face[here] - (start - len(one.faces))]
        points = np.einsum("nk,nki->ni", cover.weights[here], corners)
        out[here] = _repeated(image, _transformed(points, used))
    return out


def _base_texture(asset: Asset, primitive: dict) -> dict | None:
    if "material" not in primitive:
        return None
    material = asset.json["materials"][primitive["material"]]
    return material.get("pbrMetallicRoughness", {}).get("baseColorTexture")


def _decoded(asset: Asset, image: dict) -> np.ndarray | None:
    """(h, w, 4) float32, linear; None if the image cannot be read."""
    from PIL import Image

    try:
        if "bufferView" in image:
            view = asset.json["bufferViews"][image["bufferView"]]
            start = view.get("byteOffset", 0)
            data = bytes(asset.binary[start : start + view["byteLength"]])
        elif is_data_uri(image.get("uri", "")):
            data = data_uri_bytes(image["uri"], "image")
        else:
            return None
        rgba = np.asarray(Image.open(io.BytesIO(data)).convert("RGBA"))
    except (OSError, ValueError):
        return None
    return np.concatenate([BYTE_TO_LINEAR[rgba[..., :3]], rgba[..., 3:] / 255.0], -1).astype(np.float32)


def _transformed(uv: np.ndarray, used: dict) -> np.ndarray:
    """Texture coordinates under KHR_texture_transform."""
    transform = used.get("extensions", {}).get(_TRANSFORM, {})
    angle, scale, offset = (
        transform.get("rotation", 0.0),
        transform.get("scale", (1, 1)),
        transform.get("offset", (0, 0)),
    )
    x, y = uv[:, 0] * scale[0], uv[:, 1] * scale[1]
    c, s = np.cos(angle), np.sin(angle)
    return np.stack([c * x + s * y + offset[0], -s * x + c * y + offset[1]], 1)


def _repeated(image: np.ndarray, uv: np.ndarray) -> np.ndarray:
    """(n, 4): bilinear, with the image repeated beyond its edges, as most textures are."""
    ring = np.pad(image, ((1, 1), (1, 1), (0, 0)), mode="wrap")
    h, w = image.shape[:2]
    inside = uv - np.floor(uv)
    return looked_up(ring, (inside * (w, h) + 1.0) / (w + 2, h + 2))
