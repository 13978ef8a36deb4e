"""Base colours of materials: factor times the texture's mean colour, in linear light."""

from pathlib import Path

import numpy as np

from ...errors import InputError
from ..colour import mean_linear
from ..files import checked_file, sibling
from .document import Document, data_uri_bytes, is_data_uri
from .fields import Fields

MAX_IMAGE_BYTES = 1 << 28


class Materials:
    """Colours of materials. A texture is decoded once, when a material needs it. Unreadable textures are white.

    Alpha is ignored: a cut-out leaf is its whole rectangle.
    """

    def __init__(self, document: Document):
        self._document = document
        root = document.root
        self._materials, self._textures = root.objects("materials"), root.objects("textures")
        self._images, self._views = root.objects("images"), root.objects("bufferViews")
        self._colours: dict[int, np.ndarray] = {}
        self._means: dict[int, np.ndarray] = {}
        self.notes: list[str] = []

    def colour(self, primitive: Fields) -> np.ndarray:
        """The base colour ((3,) float64 in [0, 1]) of a primitive's material; white without a material."""
        index = primitive.whole("material", None, high=len(self._materials))
        if index is None:
            return np.ones(3)
        if index not in self._colours:
            self._colours[index] = self._base(self._materials[index])
        return self._colours[index]

    def _base(self, material: Fields) -> np.ndarray:
        model, factor, texture = (
            material.object("pbrMetallicRoughness"),
            "baseColorFactor",
            "baseColorTexture",
        )
        if model is None:  # the older extension, archived but common
            model = material.extension("KHR_materials_pbrSpecularGlossiness")
            factor, texture = "diffuseFactor", "diffuseTexture"
        if model is None:
            return np.ones(3)
        colour = np.clip(model.numbers(factor, 4, np.ones(4))[:3], 0.0, 1.0)
        used = model.object(texture)
        return colour if used is None else colour * self._mean(used)

    def _mean(self, used: Fields) -> np.ndarray:
        texture = self._textures[used.whole("index", high=len(self._textures))]
        webp = texture.extension("EXT_texture_webp")
        source = texture if "source" in texture or webp is None else webp
        index = source.whole("source", None, high=len(self._images))
        if index is None:
            return self._white(texture.where, "its format is not supported")
        if index not in self._means:
            image = self._images[index]
            try:
                self._means[index] = mean_linear(self._bytes(image))
            except (OSError, ValueError) as error:  # an InputError is a ValueError
                self._means[index] = self._white(image.where, str(error))
        return self._means[index]

    def _white(self, where: str, why: str) -> np.ndarray:
        why = " ".join(why.split())[:160].removeprefix(where + " ")
        self.notes.append(f"{where} cannot be used ({why}); taken as white")
        return np.ones(3)

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
        return buffer[start : start + size].tobytes()
