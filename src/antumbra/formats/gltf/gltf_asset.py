"""An editable glTF file: its JSON, and one binary chunk to which data are appended; pruned when written.

The contents of the file are preserved byte for byte. Only JSON objects that an edit affects change, and whatever the
edit leaves unused is removed with its bytes. Objects that the original file did not use stay, since an unknown
extension may use them; a file with unknown extensions that contain numbers is not pruned, since these may be indices.
"""

import copy
import io
import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from ...base.errors import InputError
from ...base.extras import MissingPackage
from ...base.files import sibling
from ...kernels.parallel import map_in_threads
from ...scene.materials import decode_image
from .accessors import COMPONENTS, WIDTHS, Accessors, decompress
from .accessors import DRACO_EXTENSION as DRACO
from .gltf_file import CURE, HARMLESS, SUPPORTED, Buffer, GltfDocument, data_uri_bytes, is_data_uri, open_gltf
from .gltf_materials import BASISU, IMAGE_EXTENSIONS
from .gltf_writer import GltfWriter, Json, glb_bytes

# --- Pruning: accessors, textures, images, samplers, and their bytes --------------------------------------------------


LISTS = "textures", "images", "samplers", "accessors", "bufferViews"  # each after the lists that refer to it
LIGHTMAP = "MOZ_lightmap"
"""An extension of materials: a texture of linear irradiance, and the factor on it."""

_KNOWN = (*SUPPORTED, *HARMLESS, LIGHTMAP, "KHR_node_visibility", "KHR_animation_pointer")

Used = dict[str, set[int]]
"""Name of a list in the JSON -> its referenced indices."""


def used_in(root: Json) -> Used:
    """The referenced indices of a file."""
    used: Used = {name: set() for name in LISTS}
    for name, holder, key in _references(root):
        used[name].add(holder[key])
    return used


def prune(root: Json, binary: bytes, lengths: dict[str, int], before: Used) -> tuple[Json, bytes]:
    """A copy of a file with one buffer, without objects that its edit left unused.

    lengths : name of a list -> its length before the edit
    before : the indices used before the edit
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


def _references(root: Json) -> Iterator[tuple[str, Any, Any]]:
    """Yield (list, holder, key) for all indices: ``holder[key]`` is an index into ``root[list]``."""
    yield from ((name, holder, key) for name, holder, key in _places(root) if key in holder)


def _places(root: Json) -> Iterator[tuple[str, Any, Any]]:
    """Yield (list, holder, key) for all places that may contain an index."""
    for mesh in root.get("meshes", []):
        for primitive in mesh["primitives"]:
            for attributes in (primitive["attributes"], *primitive.get("targets", [])):
                yield from (("accessors", attributes, name) for name in attributes)
            yield "accessors", primitive, "indices"
            yield "bufferViews", _extension(primitive, DRACO), "bufferView"
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


def _texture_uses(value: Any) -> Iterator[Json]:
    """Yield the objects in materials, including their extensions and extras, that refer to a texture."""
    if isinstance(value, list):
        for each in value:
            yield from _texture_uses(each)
    elif isinstance(value, dict):
        for name, each in value.items():
            if (name.endswith("Texture") or name == LIGHTMAP) and isinstance(each, dict):
                yield each
            yield from _texture_uses(each)


def _extension(holder: Json, name: str) -> Json:
    extension: Json = holder.get("extensions", {}).get(name, {})
    return extension


def _sparse(accessor: Json) -> list[Json]:
    return [accessor["sparse"][key] for key in ("indices", "values")] if "sparse" in accessor else []


def _opaque(value: Any) -> bool:
    """Whether JSON has unknown extensions that contain numbers."""
    if isinstance(value, list):
        return any(map(_opaque, value))
    if not isinstance(value, dict):
        return False
    unknown = [each for name, each in value.get("extensions", {}).items() if not name.startswith(_KNOWN)]
    return any(map(_holds_number, unknown)) or any(map(_opaque, value.values()))


def _holds_number(value: Any) -> bool:
    if isinstance(value, (dict, list)):
        return any(map(_holds_number, value.values() if isinstance(value, dict) else value))
    return isinstance(value, (int, float)) and not isinstance(value, bool)


def _drop(root: Json, name: str, dead: set[int]) -> None:
    """Remove objects from a list and renumber the others."""
    if not dead:
        return
    places = np.cumsum([i not in dead for i in range(len(root[name]))]) - 1
    for kind, holder, key in _references(root):
        if kind == name:
            holder[key] = int(places[holder[key]])
    root[name] = [each for i, each in enumerate(root[name]) if i not in dead]
    if not root[name]:
        del root[name]


def _ranges(root: Json) -> list[tuple[int, int]]:
    """The byte range (first, end) of each accessor and buffer view."""
    views = root.get("bufferViews", [])
    shared = {a["bufferView"] for a in root.get("accessors", []) if "bufferView" in a}
    shared -= {part["bufferView"] for a in root.get("accessors", []) for part in _sparse(a)}
    spans = [_span(view) for i, view in enumerate(views) if i not in shared]
    return spans + [_span_of(accessor, views) for accessor in root.get("accessors", []) if "bufferView" in accessor]


def _span(view: Json) -> tuple[int, int]:
    first = view.get("byteOffset", 0)
    return first, first + view["byteLength"]


def _span_of(accessor: Json, views: list[Json]) -> tuple[int, int]:
    """The byte range of an accessor, from the first row to the last."""
    view = views[accessor["bufferView"]]
    if accessor["type"] not in WIDTHS or accessor["componentType"] not in COMPONENTS:
        return _span(view)
    row = WIDTHS[accessor["type"]] * np.dtype(COMPONENTS[accessor["componentType"]]).itemsize
    first = view.get("byteOffset", 0) + accessor.get("byteOffset", 0)
    return first, first + view.get("byteStride", row) * (accessor["count"] - 1) + row


def _without(root: Json, binary: bytes, before: list[tuple[int, int]]) -> tuple[Json, bytes]:
    """The file without the four-byte words of the ranges `before` that no remaining object uses."""
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


# --- Editing ----------------------------------------------------------------------------------------------------------


_MIME = {
    ".png": "image/png",
    ".jpg": "image/jpeg",
    ".jpeg": "image/jpeg",
    ".webp": "image/webp",
    ".ktx2": "image/ktx2",
}


class Asset(GltfWriter):
    """A glTF file to edit; its buffer holds the buffers of the file, then appended data."""

    def __init__(self, json: Json | None = None, binary: bytes = b"") -> None:
        super().__init__(json, binary)
        self._lengths, self._used = {name: len(self.json.get(name, [])) for name in LISTS}, used_in(self.json)

    def fill(self, index: int, values: np.ndarray, *, bounds: bool = False, indices: bool = False) -> None:
        """Replace the data of an existing accessor by `values`, (n, k), in their dtype."""
        accessor = self.json["accessors"][index]
        for earlier in ("byteOffset", "min", "max"):
            accessor.pop(earlier, None)
        accessor |= self.stored(values, bounds=bounds, indices=indices)

    def image_bytes(self, index: int) -> bytes | None:
        """The encoded bytes of an image; None if it is a missing file."""
        image = self.json["images"][index]
        if "bufferView" in image:
            first, end = _span(self.json["bufferViews"][image["bufferView"]])
            return bytes(self.binary[first:end])
        uri = image.get("uri", "")
        return data_uri_bytes(uri, f"images[{index}].uri") if is_data_uri(uri) else None

    def uses_no_more(self, extension: str) -> None:
        """Remove an extension from `extensionsUsed` and `extensionsRequired`."""
        for key in ("extensionsUsed", "extensionsRequired"):
            if extension in self.json.get(key, []):
                self.json[key].remove(extension)
                if not self.json[key]:
                    del self.json[key]

    def glb(self) -> bytes:
        """The file as binary glTF, without objects that edits left unused."""
        return glb_bytes(*prune(self.json, bytes(self.binary), self._lengths, self._used))


def open_asset(path: Path) -> Asset:
    """Open a .glb or .gltf file, merge its buffers and external images into one buffer, and decompress it.

    Meshes are decompressed, and KTX2 images become PNG.

    Raises
    ------
    InputError
        If it cannot be read, a buffer has no data, or the library of a compression is missing.
    """
    document = open_gltf(path)
    asset = Asset(copy.deepcopy(document.root.data))
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
    _convert_ktx2(asset, document.file)
    return asset


def _append_buffer(binary: bytearray, buffer: Buffer | None, file: str, index: int) -> int:
    """Append a buffer at a multiple of four bytes; return its start."""
    if buffer is None:
        raise InputError(f"{file}: buffers[{index}] has no data; {CURE}")
    binary += bytes(-len(binary) % 4)
    start = len(binary)
    binary += bytes(buffer)
    return start


def _embed_image(asset: Asset, image: Json, document: GltfDocument) -> None:
    """Copy an external image into the buffer. A missing file keeps its URI."""
    uri = image.get("uri")
    if uri is None or is_data_uri(uri):
        return
    path = sibling(document.folder, uri, f"{document.file}: image")
    if path.is_file() and path.suffix.lower() in _MIME:
        del image["uri"]
        image |= {"mimeType": _MIME[path.suffix.lower()], "bufferView": asset.view(path.read_bytes())}


def _decompress(asset: Asset, document: GltfDocument) -> None:
    """Decompress Draco data into accessors, and drop the extension, whose data lack the baked attributes."""
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


def image_of_texture(texture: Json) -> int | None:
    """The index of the image that a texture shows, from the texture itself or from an extension."""
    holders = (texture, *(_extension(texture, name) for name in IMAGE_EXTENSIONS))
    return next((each["source"] for each in holders if "source" in each), None)


def _convert_ktx2(asset: Asset, file: str) -> None:
    """Convert KTX2 images to PNG, and drop KHR_texture_basisu. Images that cannot be decoded stay as they are."""
    textures = [t for t in asset.json.get("textures", []) if "source" in _extension(t, BASISU)]
    indices = sorted({_extension(t, BASISU)["source"] for t in textures if "source" not in t})
    pngs = dict(zip(indices, map_in_threads(lambda index: _png_of(asset, index, file), indices)))
    for index, png in pngs.items():
        if png is not None:
            image = asset.json["images"][index]
            image.pop("uri", None)
            image |= {"mimeType": "image/png", "bufferView": asset.view(png)}
    for texture in textures:
        if "source" not in texture:
            source = _extension(texture, BASISU)["source"]
            if pngs[source] is None:
                continue
            texture["source"] = source
        del texture["extensions"][BASISU]
        if not texture["extensions"]:
            del texture["extensions"]
    if not any(_extension(t, BASISU) for t in textures):
        asset.uses_no_more(BASISU)


def _png_of(asset: Asset, index: int, file: str) -> bytes | None:
    """A KTX2 image as PNG; None if it cannot be decoded."""
    from PIL import Image

    data = asset.image_bytes(index)
    try:
        pixels = decode_image(data or b"")
    except MissingPackage as error:
        raise MissingPackage(f"{file}: images[{index}]: {error}") from None
    except ValueError:
        return None
    stream = io.BytesIO()
    Image.fromarray(pixels if (pixels[..., 3] < 255).any() else pixels[..., :3]).save(stream, "PNG")
    return stream.getvalue()
