"""An editable glTF file: its JSON, and one binary chunk to which data are appended; pruned when written.

What is in the file stays as it is, byte for byte. Only JSON objects that a bake concerns change, and whatever the edit
left unused is removed with its bytes. Objects that the file itself never used stay, since an unknown extension may use
them; a file with unknown extensions that hold numbers is not pruned, since these may be indices.
"""

import copy
import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from ...errors import InputError
from ...files import sibling
from ...formats.gltf.accessors import COMPONENTS, WIDTHS, Accessors, decompress
from ...formats.gltf.accessors import DRACO_EXTENSION as DRACO
from ...formats.gltf.gltf_file import (
    ARRAY_BUFFER,
    CURE,
    ELEMENT_ARRAY_BUFFER,
    HARMLESS,
    SUPPORTED,
    GltfDocument,
    assemble_glb,
    is_data_uri,
    open_gltf,
)

# --- Removes what an edit left unused: accessors, textures, images, samplers, and their bytes -------------------------
#
# Objects that the file itself never used stay, since something unknown may use them. A file with unknown extensions
# that hold numbers stays whole: these may be indices.


LISTS = "textures", "images", "samplers", "accessors", "bufferViews"  # each after those that refer to it
_KNOWN = (*SUPPORTED, *HARMLESS, "KHR_node_visibility", "KHR_animation_pointer")

Used = dict[str, set[int]]
"""Name of a list of the JSON -> the indices that something refers to."""


def used_in(root: dict) -> Used:
    """What is used in a file."""
    used: Used = {name: set() for name in LISTS}
    for name, holder, key in _references(root):
        used[name].add(holder[key])
    return used


def prune(root: dict, binary: bytes, lengths: dict[str, int], before: Used) -> tuple[dict, bytes]:
    """A copy of a file of one buffer, without what its edit left unused.

    given : name of a list -> its length before the edit
    before : what was used then
    """
    root = json.loads(json.dumps(root))
    if _opaque(root):
        return root, binary
    spans = _ranges(root)
    for name in LISTS:
        now = used_in(root)[name]
        unused = {i for i in range(len(root.get(name, []))) if i not in now}
        _drop(root, name, {i for i in unused if i >= lengths[name] or i in before[name]})
    return _without(root, binary, spans)


def _references(root: dict) -> Iterator[tuple[str, Any, Any]]:
    """(list, holder, key) of all indices: ``holder[key]`` is an index in ``root[list]``."""
    yield from ((name, holder, key) for name, holder, key in _places(root) if key in holder)


def _places(root: dict) -> Iterator[tuple[str, Any, Any]]:
    for mesh in root.get("meshes", []):
        for primitive in mesh["primitives"]:
            for attributes in (primitive["attributes"], *primitive.get("targets", [])):
                yield from (("accessors", attributes, name) for name in attributes)
            yield "accessors", primitive, "indices"
            yield "bufferViews", _extension(primitive, "KHR_draco_mesh_compression"), "bufferView"
    for node in root.get("nodes", []):
        attributes = _extension(node, "EXT_mesh_gpu_instancing").get("attributes", {})
        yield from (("accessors", attributes, name) for name in attributes)
    for skin in root.get("skins", []):
        yield "accessors", skin, "inverseBindMatrices"
    for sampler in (sampler for animation in root.get("animations", []) for sampler in animation["samplers"]):
        yield "accessors", sampler, "input"
        yield "accessors", sampler, "output"
    for accessor in root.get("accessors", []):
        for holder in (accessor, *_sparse(accessor)):
            yield "bufferViews", holder, "bufferView"
    for image in root.get("images", []):
        yield "bufferViews", image, "bufferView"
    for texture in root.get("textures", []):
        yield "samplers", texture, "sampler"
        for holder in (texture, *texture.get("extensions", {}).values()):
            yield "images", holder, "source"
    yield from (("textures", holder, "index") for holder in _texture_uses(root.get("materials", [])))


def _texture_uses(value) -> Iterator[dict]:
    """The objects of materials, of their extensions and extras, that refer to a texture."""
    if isinstance(value, list):
        for each in value:
            yield from _texture_uses(each)
    elif isinstance(value, dict):
        for name, each in value.items():
            if name.endswith("Texture") and isinstance(each, dict):
                yield each
            yield from _texture_uses(each)


def _extension(holder: dict, name: str) -> dict:
    return holder.get("extensions", {}).get(name, {})


def _sparse(accessor: dict) -> list[dict]:
    return [accessor["sparse"][key] for key in ("indices", "values")] if "sparse" in accessor else []


def _opaque(value) -> bool:
    """Whether JSON has unknown extensions that hold numbers."""
    if isinstance(value, list):
        return any(map(_opaque, value))
    if not isinstance(value, dict):
        return False
    unknown = [each for name, each in value.get("extensions", {}).items() if not name.startswith(_KNOWN)]
    return any(map(_holds_number, unknown)) or any(map(_opaque, value.values()))


def _holds_number(value) -> bool:
    if isinstance(value, (dict, list)):
        return any(map(_holds_number, value.values() if isinstance(value, dict) else value))
    return isinstance(value, (int, float)) and not isinstance(value, bool)


def _drop(root: dict, name: str, dead: set[int]) -> None:
    """Remove objects of a list, and count the others anew."""
    if not dead:
        return
    places = np.cumsum([i not in dead for i in range(len(root[name]))]) - 1
    for kind, holder, key in _references(root):
        if kind == name:
            holder[key] = int(places[holder[key]])
    root[name] = [each for i, each in enumerate(root[name]) if i not in dead]
    if not root[name]:
        del root[name]


def _ranges(root: dict) -> list[tuple[int, int]]:
    """The bytes that accessors and buffer views have: (first, end) of each."""
    views = root.get("bufferViews", [])
    shared = {a["bufferView"] for a in root.get("accessors", []) if "bufferView" in a}
    shared -= {part["bufferView"] for a in root.get("accessors", []) for part in _sparse(a)}
    spans = [_span(view) for i, view in enumerate(views) if i not in shared]
    return spans + [_span_of(accessor, views) for accessor in root.get("accessors", []) if "bufferView" in accessor]


def _span(view: dict) -> tuple[int, int]:
    first = view.get("byteOffset", 0)
    return first, first + view["byteLength"]


def _span_of(accessor: dict, views: list[dict]) -> tuple[int, int]:
    """The bytes of an accessor, from the first row to the last."""
    view = views[accessor["bufferView"]]
    if accessor["type"] not in WIDTHS or accessor["componentType"] not in COMPONENTS:
        return _span(view)
    row = WIDTHS[accessor["type"]] * np.dtype(COMPONENTS[accessor["componentType"]]).itemsize
    first = view.get("byteOffset", 0) + accessor.get("byteOffset", 0)
    return first, first + view.get("byteStride", row) * (accessor["count"] - 1) + row


def _without(root: dict, binary: bytes, before: list[tuple[int, int]]) -> tuple[dict, bytes]:
    """The file without the words of four bytes that only objects of `before` had, which are gone."""
    words = np.ones(-(-len(binary) // 4), bool)
    for first, end in before:
        words[first // 4 : -(-end // 4)] = False
    for first, end in _ranges(root):
        words[first // 4 : -(-end // 4)] = True
    if words.all():
        return root, binary
    start = 4 * (np.cumsum(words) - words)

    def moved(byte: int) -> int:
        return int(start[byte // 4]) + (byte % 4 if words[byte // 4] else 0)

    views = root.get("bufferViews", [])
    for accessor in root.get("accessors", []):
        if accessor.get("byteOffset"):
            base = views[accessor["bufferView"]].get("byteOffset", 0)
            accessor["byteOffset"] = moved(base + accessor["byteOffset"]) - moved(base)
    for view in views:
        first, end = _span(view)
        last = moved(end - 1) + int(words[(end - 1) // 4])
        view |= {"byteOffset": moved(first), "byteLength": last - moved(first)}
    padded = np.frombuffer(binary + bytes(-len(binary) % 4), np.uint8).reshape(-1, 4)
    return root, padded[words].tobytes()


# --- A glTF file that is edited: its JSON, and its buffers as one binary chunk, to which data are appended ------------
#
# What is in the file stays as it is, byte for byte. Only the JSON objects that a bake concerns are changed, and what
# they alone used is left out.


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
        self._lengths, self._used = {name: len(json.get(name, [])) for name in LISTS}, used_in(json)

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
        root, binary = prune(self.json, bytes(self.binary), self._lengths, self._used)
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
    starts = [_append_buffer(asset.binary, buffer, document.file, i) for i, buffer in enumerate(document.buffers)]
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
        _embed_image(asset, image, document)
    _decompress(asset, document)
    return asset


def _append_buffer(binary: bytearray, buffer, file: str, index: int) -> int:
    if buffer is None:
        raise InputError(f"{file}: buffers[{index}] has no data; {CURE}")
    binary += bytes(-len(binary) % 4)
    start = len(binary)
    binary += buffer.tobytes()
    return start


def _embed_image(asset: Asset, image: dict, document: GltfDocument) -> None:
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
                asset.fill(index, accessors.stored(index), **{name: index == target for name, target in place.items()})
            del primitive["extensions"][DRACO]
            if not primitive["extensions"]:
                del primitive["extensions"]
    asset.uses_no_more(DRACO)
