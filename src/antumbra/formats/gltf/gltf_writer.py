"""The one writer of GLB files: glTF JSON, and one buffer to which arrays and images are appended."""

import json
import math
import struct
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ...base.files import atomic_output
from ...kernels.small_matrices import length
from ...scene.palette_scene import PaletteScene
from .accessors import COMPONENTS, WIDTHS
from .gltf_file import BINARY_CHUNK, GLB_MAGIC, JSON_CHUNK
from .gltf_nodes import LIGHTS_EXTENSION

Json: TypeAlias = dict[str, Any]
"""An object of glTF JSON."""

LINES, TRIANGLES = 1, 4
"""`mode` of primitives."""

UNLIT = "KHR_materials_unlit"

_ARRAY_BUFFER, _ELEMENT_ARRAY_BUFFER = 34962, 34963  # `target` of buffer views with vertices and with indices
_CODES = {np.dtype(kind): code for code, kind in COMPONENTS.items()}
_TYPES = {width: name for name, width in WIDTHS.items() if name != "MAT4"}
_UPRIGHT = [1.0, 0.0, 0.0, 0.0, 0.0, 0.0, -1.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0]  # column-major


def up_axis_transform(up: str, metres: float = 1.0) -> Json:
    """The node transform that rotates the up axis of a scene, "y" or "z", to glTF's +Y, and scales it to metres.

    A matrix, not a quaternion, whose square roots of 1/2 would cause rounding errors in the coordinates.

    metres : the length of a unit of the scene
    """
    if metres == 1.0:
        return {"matrix": _UPRIGHT} if up == "z" else {}
    turn = np.array(_UPRIGHT).reshape(4, 4) if up == "z" else np.eye(4)
    return {"matrix": (np.diag([metres, metres, metres, 1.0]) @ turn).ravel().tolist()}


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
        self,
        positions: np.ndarray,
        indices: np.ndarray | None = None,
        colours: ArrayLike | None = None,
        normals: np.ndarray | None = None,
        **fields: Any,
    ) -> Json:
        """Append the arrays of a primitive, and return it.

        positions : (v, 3), stored as float32
        indices : whole numbers of any shape, stored as uint32; None: all positions in order
        colours : (v, 3), linear, stored as float32
        normals : (v, 3), unit, stored as float32
        fields : further fields, such as the material
        """
        attributes = {"POSITION": self.accessor(np.asarray(positions, "<f4"), bounds=True)}
        if normals is not None:
            attributes["NORMAL"] = self.accessor(np.asarray(normals, "<f4"))
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


# --- Scenes with palette colours --------------------------------------------------------------------------------------


def write_glb(scene: PaletteScene, name: str, path: Path) -> list[Path]:
    """Write a scene to a .glb file; return its path in a list.

    It has linear float colours and a light (KHR_lights_punctual), unlike files of trimesh.
    """
    writer = GltfWriter()
    material = writer.add("materials", {"pbrMetallicRoughness": {"metallicFactor": 0.0}, "doubleSided": True})
    vertices, colours, indices = _coloured_vertices(scene)
    primitive = writer.primitive(vertices, indices, colours, material=material)
    writer.add_root({"name": name, "mesh": writer.add("meshes", {"name": name, "primitives": [primitive]})})
    writer.add("cameras", _lens(scene.camera))
    writer.add_root(_camera_node(scene.camera))
    writer.uses(LIGHTS_EXTENSION)
    writer.json["extensions"] = {LIGHTS_EXTENSION: {"lights": [_point_light(scene.light)]}}
    writer.add_root(_light_node(scene.light))
    with atomic_output(path) as temporary:
        temporary.write_bytes(writer.glb())
    return [path]


def _coloured_vertices(
    scene: PaletteScene,
) -> tuple[NDArray[np.float32], NDArray[np.float32], NDArray[np.uint32]]:
    """Positions and linear colours, (v, 3) float32 each, and indices, (f, 3) uint32. Vertices are split by colour."""
    n = len(scene.palette)
    key = np.asarray(scene.faces, np.int64) * n + np.asarray(scene.colour, np.int64)[:, None]
    used, indices = np.unique(key, return_inverse=True)
    vertices, palette = np.asarray(scene.vertices, "<f4"), np.asarray(scene.palette, "<f4")
    return vertices[used // n], palette[used % n], indices.reshape(key.shape).astype("<u4")


def _camera_node(camera: dict[str, Any]) -> Json:
    """The node of a camera. A glTF camera looks along its node's -Z, with +Y up."""
    position, target, up = (np.asarray(camera.get(k, (0, 1, 0)), float) for k in ("position", "target", "up"))
    back = (position - target) / length(position - target)
    right = np.cross(up, back) / np.linalg.norm(np.cross(up, back))
    columns = np.c_[np.stack([right, np.cross(back, right), back, position]), (0, 0, 0, 1)]
    return {"name": "camera", "camera": 0, "matrix": columns.ravel().tolist()}


def _lens(camera: dict[str, Any]) -> Json:
    return {"type": "perspective", "perspective": {"yfov": math.radians(camera.get("vfov", 60.0)), "znear": 0.01}}


def _light_node(light: dict[str, Any]) -> Json:
    corner, u, v = (np.asarray(light[k], float) for k in ("corner", "u", "v"))
    middle = corner + (u + v) / 2.0
    return {"name": "light", "translation": middle.tolist(), "extensions": {LIGHTS_EXTENSION: {"light": 0}}}


def _point_light(light: dict[str, Any]) -> Json:
    colour = [float(c) for c in light.get("colour", (1.0, 1.0, 1.0))]
    return {"type": "point", "color": colour, "intensity": float(light.get("intensity", 1.0))}
