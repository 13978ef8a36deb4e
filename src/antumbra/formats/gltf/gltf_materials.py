"""glTF materials: base colour, alpha mode, metallic-roughness parameters and maps, and a note on ignored fields."""

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
    Affine,
    Material,
    PbrParameters,
    Texture,
    TextureMap,
    check_textures,
    checked_size,
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
EMISSIVE_STRENGTH = "KHR_materials_emissive_strength"
UNLIT = "KHR_materials_unlit"
_TRANSMISSION = "KHR_materials_transmission"
_SPECULAR = "KHR_materials_pbrSpecularGlossiness"  # the older material model, archived but common


class _Coordinates(NamedTuple):
    """The texture coordinates of a texture."""

    uv_set: str  # attribute
    transform: NDArray[np.float64] | None  # (2, 3) float64: KHR_texture_transform; None: none


def _coordinates(info: Fields) -> _Coordinates:
    """The coordinates of a reference to a texture."""
    transform, uv_set = info.extension(_TRANSFORM), info.whole("texCoord", 0)
    if transform is not None:
        uv_set = transform.whole("texCoord", uv_set)
    return _Coordinates(f"TEXCOORD_{uv_set}", None if transform is None else _matrix(transform))


_IDENTITY: Affine = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0))


def _relative(own: _Coordinates, shared: _Coordinates) -> Affine | None:
    """The map from shared texture coordinates to a texture's own; None if there is none."""
    ours, theirs = (np.eye(2, 3) if each.transform is None else each.transform for each in (own, shared))
    if np.array_equal(ours, theirs):
        return _IDENTITY
    (a, b, x), (c, d, y) = theirs.tolist()
    if (area := a * d - b * c) == 0.0:
        return None
    back = np.array([[d, -b, b * y - d * x], [-c, a, c * x - a * y], [0.0, 0.0, area]]) / area
    (a, b, x), (c, d, y) = product(ours, back).tolist()
    return (a, b, x), (c, d, y)


class MappedMaterial(NamedTuple):
    """A material and its texture mapping."""

    material: Material
    uv_set: str = "TEXCOORD_0"  # attribute with the texture coordinates
    transform: NDArray[np.float64] | None = None  # (2, 3) float64: their KHR_texture_transform; None: none
    second_set: str | None = None  # attribute with the coordinates of maps that have a set of their own

    def transformed(self, uv: np.ndarray) -> np.ndarray:
        """Texture coordinates ((v, 2)) under the transform."""
        return uv if self.transform is None else product(uv, self.transform[:, :2].T) + self.transform[:, 2]


_TextureKey: TypeAlias = tuple[int, int, int, bool, bool, bool]
"""An image, its wrap modes, whether the nearest texel is shown, whether alpha matters, and whether it holds data."""


class GltfMaterials:
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
        self._map_textures: dict[_TextureKey, Texture] = {}  # besides base colours
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
        coordinates = None
        if texture_info is not None:
            texture = self._textures[texture_info.whole("index", high=len(self._textures))]
            image = self._texture(texture, mode != OPAQUE)
            material = without_texture(material) if image is None else material._replace(texture=image)
            coordinates = _coordinates(texture_info)
        if fields.extension(UNLIT) is None and (
            "pbrMetallicRoughness" in fields or fields.extension(_SPECULAR) is None
        ):
            pbr, coordinates, second = self._pbr(fields, coordinates)
            material = material._replace(pbr=None if pbr.is_plain else pbr)
            if coordinates is not None:
                return MappedMaterial(material, *coordinates, second)
        return MappedMaterial(material, *(coordinates or ()))

    def _pbr(
        self, fields: Fields, shared: "_Coordinates | None"
    ) -> "tuple[PbrParameters, _Coordinates | None, str | None]":
        """The parameters besides the base colour, the coordinates that textures share, and a second set of some.

        The shared coordinates are `shared`, if given. Normal maps have them, since tangents follow from them.
        """
        second: str | None = None
        model = fields.object("pbrMetallicRoughness") or Fields({}, fields.where)

        def mapped(info: Fields | None, holds_data: bool = True, bends: bool = False) -> TextureMap | None:
            nonlocal shared, second
            if info is None:
                return None
            own = _coordinates(info)
            shared = own if shared is None else shared
            if own.uv_set != shared.uv_set and second in (None, own.uv_set) and not bends:
                second = own.uv_set
                found = self._map(info, own, _Coordinates(second, None), holds_data)
                return None if found is None else found._replace(second=True)
            return self._map(info, own, shared, holds_data)

        factors = (model.number(f"{key}Factor", 1.0) for key in ("metallic", "roughness"))
        metal, roughness = (float(np.clip(factor, 0.0, 1.0)) for factor in factors)
        brighter = fields.extension(EMISSIVE_STRENGTH)
        strength = 1.0 if brighter is None else float(np.clip(brighter.number("emissiveStrength", 1.0), 0.0, 1e30))
        r, g, b = (strength * np.clip(fields.numbers("emissiveFactor", 3, np.zeros(3)), 0.0, 1.0)).tolist()
        shade, bump = fields.object("occlusionTexture"), fields.object("normalTexture")
        pbr = PbrParameters(
            metallic=metal,
            roughness=roughness,
            metal_map=mapped(model.object("metallicRoughnessTexture")),
            occlusion_map=mapped(shade),
            occlusion_strength=1.0 if shade is None else float(np.clip(shade.number("strength", 1.0), 0.0, 1.0)),
            normal_map=mapped(bump, bends=True),
            normal_scale=1.0 if bump is None else bump.number("scale", 1.0),
            emission=(r, g, b),
            emission_map=mapped(fields.object("emissiveTexture"), False) if any((r, g, b)) else None,
        )
        return pbr, shared, second

    def _map(self, info: Fields, own: "_Coordinates", shared: "_Coordinates", holds_data: bool) -> TextureMap | None:
        """A texture besides the base colour; None, with a note, if it cannot be used."""
        texture = self._textures[info.whole("index", high=len(self._textures))]
        key, reason = self._key(texture, False, holds_data), "its format is not supported"
        transform = _relative(own, shared)
        if own.uv_set != shared.uv_set:
            key, reason = None, f"it has texture coordinates of its own, {own.uv_set}"
        elif transform is None:
            key, reason = None, "the texture coordinates of its material have no inverse"
        found = None if key is None else self._cache.get(key) or self._map_textures.get(key)
        if found is None and key is not None:
            try:
                found = self._map_textures[key] = self._checked_texture(key)
            except (OSError, ValueError) as error:
                reason = str(error)
        if found is None:
            self._note(info.where, reason, "left out")
            return None
        return TextureMap(found, None if transform == _IDENTITY else transform)

    def _checked_texture(self, key: _TextureKey) -> Texture:
        """A texture that pictures decode. Raises ValueError if its header is that of no image."""
        texture = self._new_texture(key)
        assert isinstance(texture.picture, bytes)
        checked_size(texture.picture)
        return texture

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

    def _key(self, texture: Fields, has_alpha: bool, holds_data: bool = False) -> _TextureKey | None:
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
        return index, wrap_s, wrap_t, sampler.whole("magFilter", 0) == _NEAREST, has_alpha, holds_data

    def _place(self, image: Fields) -> tuple[Any, ...]:
        """Where the bytes of an image are: images of the same bytes are decoded once."""
        if (uri := image.text("uri", None)) is not None:
            return (uri,)
        view = self._views[image.whole("bufferView", high=len(self._views))]
        return tuple(view.whole(name, 0) for name in ("buffer", "byteOffset", "byteLength"))

    def _new_texture(self, key: _TextureKey) -> Texture:
        index, wrap_s, wrap_t, nearest, has_alpha, holds_data = key
        image = self._images[index]
        return Texture(image.where, self._bytes(image), wrap_s, wrap_t, nearest, has_alpha, holds_data=holds_data)

    def _note(self, where: str, reason: str, instead: str = "shown in pink") -> None:
        reason = " ".join(reason.split())[:160].removeprefix(where + " ")
        self.notes.append(f"{where} cannot be used ({reason}); {instead}")

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
    return [f"{root.where} left out: {', '.join(sorted(properties))}"] if properties else []


def _ignored_properties(material: Fields) -> Iterator[str]:
    if material.object("pbrMetallicRoughness") is None and material.extension(_SPECULAR) is not None:
        yield "specular and glossiness"
    transmission = material.extension(_TRANSMISSION)
    if transmission is not None and "transmissionTexture" in transmission:
        yield "transmission maps"
    for name, extensions in _EXTENSIONS.items():
        if any(material.extension(extension) is not None for extension in extensions):
            yield name
