"""glTF materials: base colour, texture and alpha mode, and a note on ignored fields."""

from collections.abc import Iterable, Iterator
from contextlib import suppress
from pathlib import Path
from typing import Any, NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray

from ...base.errors import InputError
from ...base.extras import MissingPackage
from ...base.files import checked_file, sibling
from ...kernels.elementary import cos, sin
from ...kernels.parallel import map_in_threads
from ...kernels.small_matrices import product
from ...scene.materials import (
    BLEND,
    CLAMP,
    MASK,
    MIRROR,
    OPAQUE,
    PLAIN,
    REPEAT,
    Material,
    Texture,
    check_textures,
    without_texture,
)
from ..json_fields import Fields
from .gltf_file import GltfDocument, data_uri_bytes, is_data_uri

# --- Base colour, texture and alpha mode ------------------------------------------------------------------------------


MAX_IMAGE_BYTES = 1 << 28
WRAPS = {10497: REPEAT, 33071: CLAMP, 33648: MIRROR}
"""Wrap modes by their numbers in samplers."""
_NEAREST = 9728
BASISU = "KHR_texture_basisu"
IMAGE_EXTENSIONS = "EXT_texture_webp", BASISU
"""Extensions of textures that name an image of another kind than PNG and JPEG."""

_TRANSFORM = "KHR_texture_transform"
_TRANSMISSION = "KHR_materials_transmission"
_SPECULAR = "KHR_materials_pbrSpecularGlossiness"  # the older material model, archived but common


class MappedMaterial(NamedTuple):
    """A material and its texture mapping."""

    material: Material
    uv_set: str = "TEXCOORD_0"  # attribute with the texture coordinates
    transform: NDArray[np.float64] | None = None  # (2, 3) float64: their KHR_texture_transform; None: none

    def transformed(self, uv: np.ndarray) -> np.ndarray:
        """Texture coordinates ((v, 2)) under the transform."""
        return uv if self.transform is None else product(uv, self.transform[:, :2].T) + self.transform[:, 2]


_TextureKey: TypeAlias = tuple[int, int, int, bool, bool]
"""An image, its wrap modes, whether the nearest texel is shown, and whether alpha matters."""


class Materials:
    """The materials of a document. Materials with the same texture share its image. Unreadable textures are pink."""

    def __init__(self, document: GltfDocument):
        self._document = document
        root = document.root
        self._materials, self._textures = root.objects("materials"), root.objects("textures")
        self._images, self._views = root.objects("images"), root.objects("bufferViews")
        self._samplers = root.objects("samplers")
        self._mapped: dict[int, MappedMaterial] = {}
        self._bad: set[int] = set()
        self._cache: dict[_TextureKey, Texture] = {}
        self._ahead: dict[_TextureKey, Texture] = {}  # from `decode_ahead`
        self._first_with: dict[tuple[Any, ...], int] = {}  # place of an image's bytes -> the first such image
        self.notes: list[str] = []

    def of_primitive(self, primitive: Fields) -> MappedMaterial:
        """The material of a primitive; white if it has none."""
        index = primitive.whole("material", None, high=len(self._materials))
        if index is None:
            return MappedMaterial(PLAIN)
        if index not in self._mapped:
            self._mapped[index] = self._read(self._materials[index])
        return self._mapped[index]

    def decode_ahead(self, primitives: Iterable[Fields]) -> None:
        """Decode the textures of primitives on all cores. `of_primitive` reports what cannot be decoded."""
        for primitive in primitives:
            with suppress(InputError, OSError):
                material = self._materials[primitive.whole("material", high=len(self._materials))]
                texture_info = _base_colour(material)[1]
                if texture_info is not None:
                    texture = self._textures[texture_info.whole("index", high=len(self._textures))]
                    key = self._key(texture, _alpha_mode(material) != OPAQUE)
                    if key is not None and key not in self._ahead:
                        self._ahead[key] = self._new_texture(key)

        def decode(texture: Texture) -> None:
            with suppress(ValueError):
                texture.preview_levels  # noqa: B018

        check_textures(self._ahead.values(), self._document.file)
        map_in_threads(decode, self._ahead.values())

    def _read(self, fields: Fields) -> MappedMaterial:
        mode = _alpha_mode(fields)
        material = Material(
            name=fields.text("name", ""),
            alpha_mode=mode,
            cutoff=fields.number("alphaCutoff", 0.5),
            double_sided=fields.flag("doubleSided"),
            transmission=_transmission(fields),
        )
        factor, texture_info = _base_colour(fields)
        r, g, b, a = np.clip(factor, 0.0, 1.0).tolist()
        material = material._replace(factor=(r, g, b, a))
        if texture_info is None:
            return MappedMaterial(material)
        texture = self._textures[texture_info.whole("index", high=len(self._textures))]
        image = self._texture(texture, mode != OPAQUE)
        material = without_texture(material) if image is None else material._replace(texture=image)
        transform = texture_info.extension(_TRANSFORM)
        uv_set = texture_info.whole("texCoord", 0)
        if transform is not None:
            uv_set = transform.whole("texCoord", uv_set)
        return MappedMaterial(material, f"TEXCOORD_{uv_set}", None if transform is None else _matrix(transform))

    def _texture(self, texture: Fields, has_alpha: bool) -> Texture | None:
        """A texture that can be decoded, else None, with one note per image."""
        key = self._key(texture, has_alpha)
        if key is None:
            self._note(texture.where, "its format is not supported")
            return None
        if key not in self._cache and key[0] not in self._bad:
            try:
                image_texture = self._ahead.get(key) or self._new_texture(key)
                image_texture.preview_levels  # noqa: B018  # decodes now: mean colours need it, and errors must be caught here
                self._cache[key] = image_texture
            except MissingPackage as error:
                raise MissingPackage(f"{self._images[key[0]].where}: {error}") from None
            except (OSError, ValueError) as error:  # an InputError is a ValueError
                self._bad.add(key[0])
                self._note(self._images[key[0]].where, str(error))
        return self._cache.get(key)

    def _key(self, texture: Fields, has_alpha: bool) -> _TextureKey | None:
        """The image of a texture, and how it is sampled; None if its format is not supported."""
        holders = (texture, *(texture.extension(name) for name in IMAGE_EXTENSIONS))
        source = next((each for each in holders if each is not None and "source" in each), texture)
        index = source.whole("source", None, high=len(self._images))
        if index is None:
            return None
        with suppress(InputError):  # reported when it is decoded
            index = self._first_with.setdefault(self._place(self._images[index]), index)
        number = texture.whole("sampler", None, high=len(self._samplers))
        sampler = Fields({}, texture.where) if number is None else self._samplers[number]
        wrap_s, wrap_t = (WRAPS.get(sampler.whole(key, 10497), REPEAT) for key in ("wrapS", "wrapT"))
        return index, wrap_s, wrap_t, sampler.whole("magFilter", 0) == _NEAREST, has_alpha

    def _place(self, image: Fields) -> tuple[Any, ...]:
        """Where the bytes of an image are: images of the same bytes are decoded once."""
        if (uri := image.text("uri", None)) is not None:
            return (uri,)
        view = self._views[image.whole("bufferView", high=len(self._views))]
        return tuple(view.whole(name, 0) for name in ("buffer", "byteOffset", "byteLength"))

    def _new_texture(self, key: _TextureKey) -> Texture:
        index, wrap_s, wrap_t, nearest, has_alpha = key
        image = self._images[index]
        return Texture(image.where, self._bytes(image), wrap_s, wrap_t, nearest, has_alpha)

    def _note(self, where: str, reason: str) -> None:
        reason = " ".join(reason.split())[:160].removeprefix(where + " ")
        self.notes.append(f"{where} cannot be used ({reason}); shown in pink")

    def _bytes(self, image: Fields) -> bytes:
        uri = image.text("uri", None)
        if uri is None:
            return self._view(image)
        if is_data_uri(uri):
            return data_uri_bytes(uri, image.place("uri"))
        path: Path = checked_file(sibling(self._document.folder, uri, image.place("uri")), uri[:80])
        if path.stat().st_size > MAX_IMAGE_BYTES:
            raise InputError(f"{uri[:80]} is too large for a texture")
        return path.read_bytes()

    def _view(self, image: Fields) -> bytes:
        view = self._views[image.whole("bufferView", high=len(self._views))]
        buffer = self._document.buffers[view.whole("buffer", high=len(self._document.buffers))]
        start, size = view.whole("byteOffset", 0), view.whole("byteLength", low=1)
        if buffer is None or start + size > len(buffer):
            raise InputError(f"{view.where} reaches beyond its buffer")
        return bytes(buffer[start : start + size])


def _base_colour(material: Fields) -> tuple[NDArray[np.float64], Fields | None]:
    """The factor of a material, (4,), and the reference to its texture; white without either."""
    model, factor, picture = material.object("pbrMetallicRoughness"), "baseColorFactor", "baseColorTexture"
    if model is None:
        model, factor, picture = material.extension(_SPECULAR), "diffuseFactor", "diffuseTexture"
    if model is None:
        return np.ones(4), None
    return model.numbers(factor, 4, np.ones(4)), model.object(picture)


def _alpha_mode(material: Fields) -> str:
    mode: str = material.text("alphaMode", OPAQUE)
    if mode not in (OPAQUE, MASK, BLEND):
        raise material.bad("alphaMode", f"{OPAQUE}, {MASK} or {BLEND}")
    return mode


def _transmission(material: Fields) -> float:
    """The share of its base colour that light keeps when it passes a surface, from KHR_materials_transmission."""
    extension = material.extension(_TRANSMISSION)
    return 0.0 if extension is None else float(np.clip(extension.number("transmissionFactor", 0.0), 0.0, 1.0))


def _matrix(transform: Fields) -> NDArray[np.float64]:
    """(2, 3) float64: offset times rotation times scale of KHR_texture_transform."""
    angle = transform.number("rotation", 0.0)
    x, y = transform.numbers("scale", 2, (1.0, 1.0))
    u, v = transform.numbers("offset", 2, (0.0, 0.0))
    c, s = cos(angle), sin(angle)
    return np.array([[c * x, s * y, u], [-s * x, c * y, v]])


# --- Ignored fields ---------------------------------------------------------------------------------------------------


_EXTENSIONS = {
    "refraction and volumes": ("KHR_materials_volume", "KHR_materials_diffuse_transmission"),
    "clearcoat": ("KHR_materials_clearcoat",),
    "sheen": ("KHR_materials_sheen",),
    "iridescence": ("KHR_materials_iridescence",),
    "anisotropy": ("KHR_materials_anisotropy",),
    "specular colours": ("KHR_materials_specular",),
}


def ignored_fields(root: Fields) -> list[str]:
    """One note that lists the material properties that are not rendered; empty if there are none."""
    properties = {name for material in root.objects("materials") for name in _ignored_properties(material)}
    if root.extension("KHR_materials_variants") is not None:
        properties.add("variants of materials")
    return [f"{root.where} left out: {', '.join(sorted(properties))}; surfaces are diffuse"] if properties else []


def _ignored_properties(material: Fields) -> Iterator[str]:
    model = material.object("pbrMetallicRoughness")
    if model is not None and ("metallicRoughnessTexture" in model or model.number("metallicFactor", 0.0) > 0.0):
        yield "metalness and roughness"
    if "normalTexture" in material:
        yield "normal maps"
    if "occlusionTexture" in material:
        yield "occlusion maps"
    if "emissiveTexture" in material or np.any(material.numbers("emissiveFactor", 3, np.zeros(3))):
        yield "emission"
    transmission = material.extension(_TRANSMISSION)
    if transmission is not None and "transmissionTexture" in transmission:
        yield "transmission maps"
    for name, extensions in _EXTENSIONS.items():
        if any(material.extension(extension) is not None for extension in extensions):
            yield name
