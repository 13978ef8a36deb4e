"""A glTF file that is edited: its JSON, and its buffers as one binary chunk, to which data are appended.

What is in the file stays as it is, byte for byte. Only the JSON objects that a bake concerns are changed, and what they
alone used is left out.
"""

import copy
import json
from pathlib import Path

import numpy as np

from ...errors import InputError
from ...files import sibling
from ...formats.gltf.accessors import COMPONENTS, WIDTHS, Accessors, decompress
from ...formats.gltf.accessors import DRACO_EXTENSION as DRACO
from ...formats.gltf.gltf_file import (
    ARRAY_BUFFER,
    CURE,
    ELEMENT_ARRAY_BUFFER,
    GltfDocument,
    assemble_glb,
    is_data_uri,
    open_gltf,
)
from .prune import LISTS, pruned, used_in

_CODES = {np.dtype(kind): code for code, kind in COMPONENTS.items()}
_TYPES = {width: name for name, width in WIDTHS.items() if name != "MAT4"}
_MIME = {".png": "image/png", ".jpg": "image/jpeg", ".jpeg": "image/jpeg", ".webp": "image/webp"}


class Asset:
    """A glTF file in memory.

    Attributes
    ----------
    json : dict
    binary : bytearray
        The only buffer: those of the file one after the other, and what was appended.
    """

    def __init__(self, json: dict, binary: bytearray):
        self.json, self.binary = json, binary
        self._given, self._used = {name: len(json.get(name, [])) for name in LISTS}, used_in(json)

    def objects(self, key: str) -> list[dict]:
        """A list at the top of the JSON, which is made if it is missing."""
        return self.json.setdefault(key, [])

    def add(self, key: str, fields: dict) -> int:
        """Append a JSON object to a list at the top, and return its index."""
        self.objects(key).append(fields)
        return len(self.json[key]) - 1

    def view(self, data: bytes, **fields) -> int:
        """Append data as a bufferView."""
        self.binary += bytes(-len(self.binary) % 4)
        start = len(self.binary)
        self.binary += data
        return self.add("bufferViews", {"buffer": 0, "byteOffset": start, "byteLength": len(data), **fields})

    def accessor(self, values: np.ndarray, *, normalized: bool = False, bounds: bool = False, indices=False) -> int:
        """Append an accessor of the rows of `values`, (n,) or (n, k), in their dtype.

        bounds : write min and max, which POSITION needs
        """
        fields = self._stored(np.ascontiguousarray(values), indices)
        if normalized:
            fields["normalized"] = True
        if bounds:
            fields |= _bounds(values)
        return self.add("accessors", fields)

    def fill(self, index: int, values: np.ndarray, *, bounds: bool = False, indices=False) -> None:
        """Give an accessor of the file values, (n, k), in their dtype."""
        accessor = self.json["accessors"][index]
        for earlier in ("byteOffset", "min", "max"):
            accessor.pop(earlier, None)
        accessor |= self._stored(np.ascontiguousarray(values), indices) | (_bounds(values) if bounds else {})

    def _stored(self, values: np.ndarray, indices: bool) -> dict:
        """Append the rows of `values`; the fields of their accessor."""
        width, row = (values.shape[1], values[0].nbytes) if values.ndim > 1 else (1, values.itemsize)
        more = {} if indices or row % 4 == 0 else {"byteStride": row + -row % 4}
        if more:  # rows of vertex attributes begin at multiples of four bytes
            padded = np.zeros((len(values), more["byteStride"]), np.uint8)
            padded[:, :row] = values.reshape(len(values), -1).view(np.uint8)
            data = padded.tobytes()
        else:
            data = values.tobytes()
        view = self.view(data, **more, target=ELEMENT_ARRAY_BUFFER if indices else ARRAY_BUFFER)
        return {
            "bufferView": view,
            "componentType": _CODES[values.dtype],
            "count": len(values),
            "type": _TYPES[width],
        }

    def texture(self, png: bytes, name: str) -> int:
        """Append a PNG as a texture whose edges are clamped."""
        image = self.add("images", {"name": name, "mimeType": "image/png", "bufferView": self.view(png)})
        sampler = {"magFilter": 9729, "minFilter": 9987, "wrapS": 33071, "wrapT": 33071}
        return self.add("textures", {"name": name, "sampler": self.add("samplers", sampler), "source": image})

    def uses(self, extension: str) -> None:
        """Name an extension among those that the file uses."""
        used: list = self.objects("extensionsUsed")
        if extension not in used:
            used.append(extension)

    def uses_no_more(self, extension: str) -> None:
        """Take an extension from those that the file uses."""
        for key in ("extensionsUsed", "extensionsRequired"):
            if extension in self.json.get(key, []):
                self.json[key].remove(extension)
                if not self.json[key]:
                    del self.json[key]

    def glb(self) -> bytes:
        """The file as binary glTF, without what edits left unused."""
        root, binary = pruned(self.json, bytes(self.binary), self._given, self._used)
        root["buffers"] = [{**(root.get("buffers") or [{}])[0], "byteLength": len(binary)}]
        text = json.dumps(root, allow_nan=False, separators=(",", ":"), ensure_ascii=False).encode()
        return assemble_glb(text, binary)


def _bounds(values: np.ndarray) -> dict:
    return {"min": values.min(0).tolist(), "max": values.max(0).tolist()}


def open_asset(path: Path) -> Asset:
    """A .glb or .gltf file, with all its buffers in one, and the images beside it in the buffer; nothing is compressed.

    Raises
    ------
    InputError
        If it cannot be read, or a buffer has no data.
    """
    document = open_gltf(path)
    asset = Asset(copy.deepcopy(document.root.data), bytearray())
    starts = [_append(asset.binary, buffer, document.file, i) for i, buffer in enumerate(document.buffers)]
    for view in asset.json.get("bufferViews", []):
        for holder in (view, *view.get("extensions", {}).values()):
            if "buffer" in holder:
                start = starts[holder["buffer"]]
                holder["buffer"] = 0
                if start:
                    holder["byteOffset"] = start + holder.get("byteOffset", 0)
    if asset.json.get("buffers"):
        asset.json["buffers"] = [{k: v for k, v in asset.json["buffers"][0].items() if k != "uri"}]
    for image in asset.json.get("images", []):
        _embed(asset, image, document)
    _decompress(asset, document)
    return asset


def _append(binary: bytearray, buffer, file: str, index: int) -> int:
    if buffer is None:
        raise InputError(f"{file}: buffers[{index}] has no data; {CURE}")
    binary += bytes(-len(binary) % 4)
    start = len(binary)
    binary += buffer.tobytes()
    return start


def _embed(asset: Asset, image: dict, document: GltfDocument) -> None:
    """Move an image beside the file into its buffer. A missing one keeps its name."""
    uri = image.get("uri")
    if uri is None or is_data_uri(uri):
        return
    path = sibling(document.folder, uri, f"{document.file}: image")
    if path.is_file() and path.suffix.lower() in _MIME:
        del image["uri"]
        image |= {"mimeType": _MIME[path.suffix.lower()], "bufferView": asset.view(path.read_bytes())}


def _decompress(asset: Asset, document: GltfDocument) -> None:
    """Give accessors the values that Draco has compressed. The extension goes: baked attributes are not in its data."""
    accessors = Accessors(document)
    for mesh, of_mesh in zip(asset.json.get("meshes", []), document.root.objects("meshes")):
        for primitive, fields in zip(mesh["primitives"], of_mesh.objects("primitives")):
            if fields.extension(DRACO) is None:
                continue
            for index in decompress(fields, accessors):
                place = {"bounds": primitive["attributes"]["POSITION"], "indices": primitive["indices"]}
                asset.fill(index, accessors.stored(index), **{name: index == own for name, own in place.items()})
            del primitive["extensions"][DRACO]
            if not primitive["extensions"]:
                del primitive["extensions"]
    asset.uses_no_more(DRACO)
