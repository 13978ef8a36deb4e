"""Materials as records of JSON, and their images, which a store keeps once, encoded as the source had them."""

import dataclasses
import io
import json
import math
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from hashlib import sha256
from typing import Any, NamedTuple

import numpy as np

from ..scene.materials import (
    BYTES_PER_PIXEL,
    CLAMP,
    MIRROR,
    REPEAT,
    Affine,
    Material,
    PbrParameters,
    Texture,
    TextureMap,
    pixel_count,
)

_WRAPS = REPEAT, CLAMP, MIRROR
_MAPS = "metal_map", "occlusion_map", "normal_map", "emission_map"
_NUMBERS = "metallic", "roughness", "occlusion_strength", "normal_scale"

# --- Writing ----------------------------------------------------------------------------------------------------------


class Images:
    """Collects the images of materials by their SHA-256, each once."""

    def __init__(self) -> None:
        self.encoded = dict[str, bytes]()
        self._keys = dict[int, tuple[object, str]]()  # by identity: textures share the bytes of their image

    def key(self, image: "bytes | np.ndarray | None") -> str | None:
        """The SHA-256 of an image, which is kept; None: there is none."""
        if image is None:
            return None
        if id(image) not in self._keys:
            data = image if isinstance(image, bytes) else _png(image)
            key = sha256(data).hexdigest()
            self.encoded[key] = data
            self._keys[id(image)] = image, key  # holds the image, so that no other one gets its identity
        return self._keys[id(image)][1]


def _png(pixels: np.ndarray) -> bytes:
    """(h, w, 4) uint8 as a PNG file."""
    from PIL import Image

    out = io.BytesIO()
    Image.fromarray(pixels, "RGBA").save(out, "PNG")
    return out.getvalue()


def material_to_json(material: Material, images: Images) -> str:
    """What pictures show of a material, as JSON; equal ones have equal texts."""
    record: dict[str, Any] = {"name": material.name, "factor": material.factor}
    if material.texture is not None:
        record["texture"] = _texture_record(material.texture, images)
    if (pbr := material.pbr) is not None:
        record["pbr"] = {name: getattr(pbr, name) for name in (*_NUMBERS, "emission")}
        for name in _MAPS:
            if (of := getattr(pbr, name)) is not None:
                record["pbr"][name] = {
                    "texture": _texture_record(of.texture, images),
                    "transform": of.transform,
                    "second": of.second,
                }
    return json.dumps(record, default=float)


def _texture_record(texture: Texture, images: Images) -> dict[str, Any]:
    return {
        "name": texture.name, "image": images.key(texture.picture), "opacity": images.key(texture.opacity),
        "wrap": [texture.wrap_s, texture.wrap_t], "nearest": texture.nearest, "has_alpha": texture.has_alpha,
        "holds_data": texture.holds_data,
    }  # fmt: skip


def images_of(material: str) -> list[str]:
    """The SHA-256 of each image of a material that `material_to_json` returned."""
    record = json.loads(material)
    textures = [record.get("texture"), *(record.get("pbr", {}).get(name, {}).get("texture") for name in _MAPS)]
    return [key for each in textures if each is not None for key in (each["image"], each["opacity"]) if key is not None]


# --- Reading ----------------------------------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class StoredTexture(Texture):
    """A texture whose images are read from the store when they are decoded."""

    images: tuple[str | None, str | None] = (None, None)  # SHA-256 of the picture and of the opacity
    read: Callable[[str], bytes] = field(default=lambda key: b"", repr=False)  # an image by its SHA-256

    def encoded(self) -> list[bytes | None]:
        """The images."""
        return [None if key is None else self.read(key) for key in self.images]

    def _decode(self, side: int | None) -> np.ndarray:
        picture, opacity = self.encoded()
        fields = {each.name: getattr(self, each.name) for each in dataclasses.fields(Texture)}
        return Texture(**fields | {"picture": picture, "opacity": opacity})._decode(side)


class StoredTextures:
    """The textures of materials: equal records share one, so that it is decoded once.

    read : reads an image by its SHA-256
    """

    def __init__(self, read: Callable[[str], bytes]):
        self._read, self._textures = read, dict[str, StoredTexture]()

    def texture(self, record: dict[str, Any]) -> Texture:
        """The texture of a record. Raises ValueError, KeyError or TypeError if its fields do not fit."""
        key = json.dumps(record, sort_keys=True)
        if key not in self._textures:
            (wrap_s, wrap_t), flags = record["wrap"], [record[name] for name in ("nearest", "has_alpha", "holds_data")]
            if wrap_s not in _WRAPS or wrap_t not in _WRAPS or not all(isinstance(each, bool) for each in flags):
                raise ValueError("a texture has no proper fields")
            if not isinstance(record["name"], str):
                raise ValueError("the name of a texture is no text")
            nearest, has_alpha, holds_data = flags
            self._textures[key] = StoredTexture(
                record["name"], None, wrap_s, wrap_t, nearest, has_alpha, None, holds_data,
                (record["image"], record["opacity"]), self._read,
            )  # fmt: skip
        return self._textures[key]

    def forget(self, kept: Iterable[Texture]) -> int:
        """Drop textures, and return the bytes of their pixels. Kernels that read these hold them."""
        some, dropped = set(kept), [each for each in self._textures.values() if "mips" in vars(each)]
        self._textures = {key: texture for key, texture in self._textures.items() if texture in some}
        return sum(each.pixels.nbytes + each.mips.nbytes for each in dropped if each not in some)


class DecodingCost(NamedTuple):
    """Memory that decoding takes."""

    stays: int  # of pixels and mip levels
    while_decoding: int

    @property
    def total(self) -> int:
        return self.stays + self.while_decoding


_DECODING = 8
"""Further bytes for each pixel of an image while it is decoded."""


def decoding_cost(textures: Iterable[Texture], threads: int) -> DecodingCost:
    """The memory that decoding of textures takes, of which those that are decoded take none."""
    waiting = [each for each in dict.fromkeys(textures) if "mips" not in vars(each)]
    sizes = [sum(map(_pixels, each.encoded())) for each in waiting if isinstance(each, StoredTexture)]
    at_once = sorted(sizes, reverse=True)[:threads]
    return DecodingCost(BYTES_PER_PIXEL * sum(sizes), _DECODING * sum(at_once))


def _pixels(image: bytes | None) -> int:
    return 0 if image is None else pixel_count(image)


def material_of(record: dict[str, Any], textures: StoredTextures) -> Material:
    """The material of a record. Raises ValueError, KeyError, AttributeError or TypeError if its fields do not fit."""
    texture = textures.texture(record["texture"]) if "texture" in record else None
    pbr = _pbr_of(record["pbr"], textures) if "pbr" in record else None
    if not isinstance(record["name"], str):
        raise ValueError("the name of a material is no text")
    red, green, blue, alpha = _numbers(record["factor"], 4)
    return Material(record["name"], (red, green, blue, alpha), texture, pbr=pbr)


def _pbr_of(record: dict[str, Any], textures: StoredTextures) -> PbrParameters:
    maps = {name: _map_of(record[name], textures) for name in _MAPS if name in record}
    values = dict(zip(_NUMBERS, _numbers([record[name] for name in _NUMBERS], len(_NUMBERS))))
    red, green, blue = _numbers(record["emission"], 3)
    return PbrParameters(**values, **maps, emission=(red, green, blue))  # type: ignore[arg-type]


def _map_of(record: dict[str, Any], textures: StoredTextures) -> TextureMap:
    transform: Affine | None = None
    if (rows := record["transform"]) is not None:
        (a, b, c), (d, e, f) = (_numbers(row, 3) for row in rows)
        if len(rows) != 2:
            raise ValueError("a transform has other than two rows")
        transform = (a, b, c), (d, e, f)
    return TextureMap(textures.texture(record["texture"]), transform, bool(record["second"]))


def _numbers(values: Any, n: int) -> list[float]:
    if len(values) != n or not all(isinstance(v, (int, float)) and math.isfinite(v) for v in values):
        raise ValueError(f"a material has {n} numbers that are none")
    return [float(value) for value in values]
