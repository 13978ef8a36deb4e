"""Removes what an edit left unused: accessors, textures, images, samplers, and their bytes.

Objects that the file itself never used stay, since something unknown may use them. A file with unknown extensions that
hold numbers stays whole: these may be indices.
"""

import json
from collections.abc import Iterator
from typing import Any

import numpy as np

from ...formats.gltf.accessors import COMPONENTS, WIDTHS
from ...formats.gltf.gltf_file import HARMLESS, SUPPORTED

LISTS = "textures", "images", "samplers", "accessors", "bufferViews"  # each after those that refer to it
_KNOWN = (*SUPPORTED, *HARMLESS, "KHR_node_visibility", "KHR_animation_pointer")

Used = dict[str, set[int]]
"""Name of a list of the JSON -> the indices that something refers to."""


def used_in(root: dict) -> Used:
    """What is used in a file."""
    found: Used = {name: set() for name in LISTS}
    for name, holder, key in _references(root):
        found[name].add(holder[key])
    return found


def pruned(root: dict, binary: bytes, given: dict[str, int], before: Used) -> tuple[dict, bytes]:
    """A copy of a file of one buffer, without what its edit left unused.

    given : name of a list -> its length before the edit
    before : what was used then
    """
    root = json.loads(json.dumps(root))
    if _opaque(root):
        return root, binary
    whole = _ranges(root)
    for name in LISTS:
        now = used_in(root)[name]
        unused = {i for i in range(len(root.get(name, []))) if i not in now}
        _drop(root, name, {i for i in unused if i >= given[name] or i in before[name]})
    return _without(root, binary, whole)


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
    whole = [_span(view) for i, view in enumerate(views) if i not in shared]
    return whole + [_span_of(accessor, views) for accessor in root.get("accessors", []) if "bufferView" in accessor]


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
