"""The one writer of GLB files: glTF JSON, and one buffer to which arrays and images are appended."""

import json
import struct
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import ArrayLike

from .accessors import COMPONENTS, WIDTHS
from .gltf_file import BINARY_CHUNK, GLB_MAGIC, JSON_CHUNK

Json: TypeAlias = dict[str, Any]
"""An object of glTF JSON."""

LINES, TRIANGLES = 1, 4
"""`mode` of primitives."""

UNLIT = "KHR_materials_unlit"

_ARRAY_BUFFER, _ELEMENT_ARRAY_BUFFER = 34962, 34963  # `target` of buffer views with vertices and with indices
_CODES = {np.dtype(kind): code for code, kind in COMPONENTS.items()}
_TYPES = {width: name for name, width in WIDTHS.items() if name != "MAT4"}
_UPRIGHT = [1.0, 0.0, 0.0, 0.0, 0.0, 0.0, -1.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0]  # column-major


def up_axis_transform(up: str) -> Json:
    """The node transform that rotates the up axis of a scene, "y" or "z", to glTF's +Y.

    A matrix, not a quaternion, whose square roots of 1/2 would cause rounding errors in the coordinates.
    """
    return {"matrix": _UPRIGHT} if up == "z" else {}


def glb_bytes(root: Json, binary: bytes | bytearray) -> bytes:
    """A GLB file, from its JSON and its only buffer."""
    root = {**root, "buffers": [{**(root.get("buffers") or [{}])[0], "byteLength": len(binary)}]}
    text = json.dumps(root, allow_nan=False, separators=(",", ":"), ensure_ascii=False).encode()
    padded_text, padding = text + b" " * (-len(text) % 4), bytes(-len(binary) % 4)
    size = len(binary) + len(padding)
    return b"".join(
        (
            struct.pack("<4sII", GLB_MAGIC, 2, 28 + len(padded_text) + size),
            struct.pack("<II", len(padded_text), JSON_CHUNK),
            padded_text,
            struct.pack("<II", size, BINARY_CHUNK),
            binary,
            padding,
        )
    )


class GltfWriter:
    """A glTF file in memory. A new one has a scene without nodes.

    Attributes
    ----------
    json : dict
    binary : bytearray
        The only buffer.
    """

    def __init__(self, json: Json | None = None, binary: bytes = b"") -> None:
        asset = {"version": "2.0", "generator": "antumbra"}
        self.json: Json = {"asset": asset, "scene": 0, "scenes": [{"nodes": []}]} if json is None else json
        self.binary = bytearray(binary)

    def objects(self, key: str) -> list[Any]:
        """A top-level list of the JSON, created if missing."""
        values: list[Any] = self.json.setdefault(key, [])
        return values

    def add(self, key: str, fields: Json) -> int:
        """Append a JSON object to a top-level list, and return its index."""
        self.objects(key).append(fields)
        return len(self.json[key]) - 1

    def add_root(self, node: Json) -> int:
        """Append a node without a parent to the first scene."""
        index = self.add("nodes", node)
        self.json["scenes"][0]["nodes"].append(index)
        return index

    def view(self, data: bytes, **fields: Any) -> int:
        """Append data as a bufferView."""
        self.binary += bytes(-len(self.binary) % 4)
        start = len(self.binary)
        self.binary += data
        return self.add("bufferViews", {"buffer": 0, "byteOffset": start, "byteLength": len(data), **fields})

    def accessor(
        self, values: np.ndarray, *, normalized: bool = False, bounds: bool = False, indices: bool = False
    ) -> int:
        """Append an accessor of the rows of `values`, (n,) or (n, k), in their dtype.

        bounds : write min and max, which POSITION needs
        """
        fields = self.stored(values, bounds=bounds, indices=indices)
        if normalized:
            fields["normalized"] = True
        return self.add("accessors", fields)

    def stored(self, values: np.ndarray, *, bounds: bool = False, indices: bool = False) -> Json:
        """Append the rows of `values`, (n,) or (n, k), to the buffer; return the fields of their accessor."""
        values = np.ascontiguousarray(values)
        width = values.shape[1] if values.ndim > 1 else 1
        row = width * values.itemsize
        stride = {} if indices or row % 4 == 0 else {"byteStride": row + -row % 4}
        if stride:  # rows of vertex attributes must be aligned to four bytes
            padded = np.zeros((len(values), stride["byteStride"]), np.uint8)
            padded[:, :row] = values.reshape(len(values), -1).view(np.uint8)
            data = padded.tobytes()
        else:
            data = values.tobytes()
        view = self.view(data, **stride, target=_ELEMENT_ARRAY_BUFFER if indices else _ARRAY_BUFFER)
        extent = {"min": values.min(0).tolist(), "max": values.max(0).tolist()} if bounds else {}
        return {
            "bufferView": view,
            "componentType": _CODES[values.dtype],
            "count": len(values),
            "type": _TYPES[width],
            **extent,
        }

    def primitive(
        self, positions: np.ndarray, indices: np.ndarray | None = None, colours: ArrayLike | None = None, **fields: Any
    ) -> Json:
        """Append the arrays of a primitive, and return it.

        positions : (v, 3), stored as float32
        indices : whole numbers of any shape, stored as uint32; None: all positions in order
        colours : (v, 3), linear, stored as float32
        fields : further fields, such as the material
        """
        attributes = {"POSITION": self.accessor(np.asarray(positions, "<f4"), bounds=True)}
        if colours is not None:
            attributes["COLOR_0"] = self.accessor(np.asarray(colours, "<f4"))
        primitive: Json = {"attributes": attributes}
        if indices is not None:
            primitive["indices"] = self.accessor(np.asarray(indices, "<u4").reshape(-1), indices=True)
        return primitive | fields

    def texture(self, png: bytes, name: str) -> int:
        """Append a PNG as a texture with wrap mode CLAMP_TO_EDGE."""
        image = self.add("images", {"name": name, "mimeType": "image/png", "bufferView": self.view(png)})
        sampler = {"magFilter": 9729, "minFilter": 9987, "wrapS": 33071, "wrapT": 33071}
        return self.add("textures", {"name": name, "sampler": self.add("samplers", sampler), "source": image})

    def uses(self, extension: str) -> None:
        """Add an extension to `extensionsUsed`."""
        used = self.objects("extensionsUsed")
        if extension not in used:
            used.append(extension)

    def make_unlit(self, material: Json) -> Json:
        """Make a material unlit, so that viewers show its colours unchanged; return it."""
        material.setdefault("extensions", {})[UNLIT] = {}
        self.uses(UNLIT)
        return material

    def glb(self) -> bytes:
        """The file as binary glTF."""
        return glb_bytes(self.json, self.binary)
