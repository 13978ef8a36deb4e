"""The base colours of texels, by which baked light is multiplied, and what textures lose.

A baked texture replaces the base colour texture, which may be finer or repeat across a surface.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..base.wording import counted
from ..formats.gltf.accessors import Accessors
from ..formats.gltf.gltf_asset import Asset, image_of_texture
from ..formats.gltf.gltf_writer import Json
from ..kernels.elementary import cos, sin
from ..scene.materials import decode_image, linear_of
from .bake_options import MAX_TEXTURE
from .baked_values import sample_bilinear
from .texture_atlas import AtlasSheet, Unwrapped, corners_of

_TRANSFORM = "KHR_texture_transform"
_CLAMP, _MIRROR = 33071, 33648  # wrap modes of samplers; others repeat
_FINER = 1.5  # texels of a texture per baked texel, along each axis, that a note is worth


class _Detail(NamedTuple):
    """The texture of a part, compared with the baked one."""

    finer: float  # texels per baked texel, along each axis
    repeats: float  # its greatest number of repetitions along an axis


class BaseColours:
    """The base colours of an asset's primitives."""

    def __init__(self, asset: Asset, accessors: Accessors):
        self._asset, self._accessors = asset, accessors
        self._images: dict[int, NDArray[np.float32] | None] = {}
        self._details: list[_Detail] = []
        self._unreadable = 0  # parts

    def texels(self, sheet: AtlasSheet, primitives: Sequence[Json]) -> NDArray[np.float32]:
        """(n, 4) float32: linear base colour and alpha of the covered texels, without the materials' factors.

        primitives : original JSON of each member of the sheet
        """
        cover, out, start = sheet.cover, np.ones((len(sheet.cover.texel), 4), np.float32), 0
        for one, primitive in zip(sheet.unwrapped, primitives):
            first, start = start, start + len(one.faces)
            inside = (cover.face >= first) & (cover.face < start)
            texture = self._texture(primitive)
            if texture is None or not inside.any():
                continue
            fields = self._asset.json["textures"][texture["index"]]
            image, name = self._image(image_of_texture(fields)), uv_set_of(texture)
            if image is None or name not in primitive["attributes"]:
                self._unreadable += 1
                continue
            uv = transformed_coordinates(
                self._accessors.finite(primitive["attributes"][name], "VEC2")[one.part.rows], texture
            )
            corners = corners_of([one], [uv])
            self._details.append(_detail(one, corners, image.shape[1::-1], cover.size))
            points = np.einsum(
                "nk,nki->ni", cover.weights[inside], corners[cover.face[inside] - (start - len(one.faces))]
            )
            out[inside] = _sampled(image, points, self._wraps(fields))
        return out

    def notes(self, size: int) -> list[str]:
        """What is lost in a baked texture of `size` texels per side."""
        notes, lost = [], [each for each in self._details if each.finer > _FINER]
        if lost:
            finer, repeats = max(each.finer for each in lost), max(each.repeats for each in lost)
            repeated = f" and repeat up to {repeats:.0f} times" if repeats > 1.5 else ""
            enough = int(np.ceil(size * finer / 64.0)) * 64
            raised = f", or raise texture to {enough}" if enough <= MAX_TEXTURE else ""
            notes.append(
                f"{counted(len(lost), 'part', 'have')} textures that are up to {finer:.1f} times finer than the "
                f"baked one{repeated}, which replaces them; to keep their detail, leave unlit out{raised}"
            )
        if self._unreadable:
            notes.append(
                f"{counted(self._unreadable, 'part', 'have')} textures that cannot be read; they are baked as white"
            )
        return notes

    def _texture(self, primitive: Json) -> Json | None:
        if "material" not in primitive:
            return None
        material = self._asset.json["materials"][primitive["material"]]
        texture: Json | None = material.get("pbrMetallicRoughness", {}).get("baseColorTexture")
        return texture

    def _image(self, index: int | None) -> NDArray[np.float32] | None:
        """(h, w, 4) float32, linear; None if the image cannot be read."""
        if index is None:
            return None
        if index not in self._images:
            try:
                data = self._asset.image_bytes(index)
                self._images[index] = None if data is None else linear_of(decode_image(data))
            except ValueError:
                self._images[index] = None
        return self._images[index]

    def _wraps(self, texture: Json) -> tuple[int, int]:
        """The wrap modes of a texture, of u and of v."""
        sampler = self._asset.json["samplers"][texture["sampler"]] if "sampler" in texture else {}
        return sampler.get("wrapS", 0), sampler.get("wrapT", 0)


def _detail(one: Unwrapped, corners: NDArray[np.float64], shape: tuple[int, ...], size: int) -> _Detail:
    """Compare a texture of a shape, (w, h), with the sheet of a part; corners : (f, 3, 2), texture coordinates."""
    own, baked = _area(corners * np.array(shape)), _area(one.uv[one.faces] * size)
    return _Detail(float(np.sqrt(own / max(baked, 1e-300))), float(np.ptp(corners.reshape(-1, 2), axis=0).max()))


def _area(corners: NDArray[np.float64]) -> float:
    """The area of triangles, (f, 3, 2), twice."""
    a, b = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    return float(np.abs(a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]).sum())


def uv_set_of(texture: Json) -> str:
    """The attribute with the coordinates of a texture."""
    transform = texture.get("extensions", {}).get(_TRANSFORM, {})
    return f"TEXCOORD_{transform.get('texCoord', texture.get('texCoord', 0))}"


def transformed_coordinates(uv: NDArray[np.float64], texture: Json) -> NDArray[np.float64]:
    """Texture coordinates under KHR_texture_transform."""
    transform = texture.get("extensions", {}).get(_TRANSFORM, {})
    angle, scale, offset = (
        transform.get("rotation", 0.0),
        transform.get("scale", (1, 1)),
        transform.get("offset", (0, 0)),
    )
    x, y = uv[:, 0] * scale[0], uv[:, 1] * scale[1]
    c, s = cos(angle), sin(angle)
    return np.stack([c * x + s * y + offset[0], -s * x + c * y + offset[1]], 1)


def _sampled(image: NDArray[np.float32], uv: NDArray[np.float64], wraps: tuple[int, int]) -> np.ndarray:
    """(n, 4): bilinear samples of an image with wrap modes of u and v."""
    places, h, w = uv.copy(), *image.shape[:2]
    for axis, wrap in enumerate(wraps):  # u runs along the image's second axis
        along = uv[:, axis]
        if wrap == _CLAMP:
            places[:, axis] = np.clip(along, 0.0, 1.0)
        elif wrap == _MIRROR:
            places[:, axis] = 1.0 - np.abs(along % 2.0 - 1.0)
        else:
            places[:, axis] = along - np.floor(along)
        ends = [(0, 0)] * 3
        ends[1 - axis] = (1, 1)
        image = np.pad(image, ends, mode="edge" if wrap in (_CLAMP, _MIRROR) else "wrap")
    return sample_bilinear(image, (places * (w, h) + 1.0) / (w + 2, h + 2))
