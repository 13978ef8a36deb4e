"""Reads baked files independently of the loader, and makes small scenes to bake."""

import io
import json
import struct

import numpy as np
from PIL import Image

from gltf_files import Gltf

KIND = {5121: "u1", 5123: "<u2", 5125: "<u4", 5126: "<f4"}
WIDTH = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4}


class Glb:
    """A GLB file: `json`, `binary`, and its accessors as arrays."""

    def __init__(self, path):
        data = path.read_bytes()
        size = struct.unpack_from("<I", data, 12)[0]
        self.json = json.loads(data[20 : 20 + size])
        self.binary = data[28 + size :]

    def array(self, index):
        accessor = self.json["accessors"][index]
        view = self.json["bufferViews"][accessor["bufferView"]]
        kind, width = np.dtype(KIND[accessor["componentType"]]), WIDTH[accessor["type"]]
        stride = view.get("byteStride", kind.itemsize * width)
        start = view.get("byteOffset", 0) + accessor.get("byteOffset", 0)
        rows = [np.frombuffer(self.binary, kind, width, start + i * stride) for i in range(accessor["count"])]
        values = np.array(rows)
        return values / np.iinfo(kind).max if accessor.get("normalized") else values

    def primitive(self, node=0, index=0):
        return self.json["meshes"][self.json["nodes"][node]["mesh"]]["primitives"][index]

    def attribute(self, name, node=0, index=0):
        return self.array(self.primitive(node, index)["attributes"][name])

    def image(self, index=0):
        """Image `index`, as it is stored."""
        view = self.json["bufferViews"][self.json["images"][index]["bufferView"]]
        data = self.binary[view["byteOffset"] : view["byteOffset"] + view["byteLength"]]
        return np.asarray(Image.open(io.BytesIO(data)))


def grid(x, z, y=0.0):
    """((v, 3) float32, (f, 3) uint32): a floor with vertices at these x and z, that faces up."""
    xs, zs = np.meshgrid(x, z, indexing="ij")
    points = np.stack([xs, np.full_like(xs, y), zs], -1).reshape(-1, 3).astype(np.float32)
    n, m = len(x), len(z)
    a = (np.arange(n - 1)[:, None] * m + np.arange(m - 1)).ravel()
    faces = np.concatenate([np.stack([a, a + 1, a + m], 1), np.stack([a + 1, a + m + 1, a + m], 1)])
    return points, faces.astype(np.uint32)


def box(low, high):
    """((8, 3) float32, (12, 3) uint32): a closed box whose faces point outward."""
    corners = np.array([[(low, high)[i >> k & 1][k] for k in range(3)] for i in range(8)], np.float32)
    quads = np.array([[0, 4, 6, 2], [1, 3, 7, 5], [0, 1, 5, 4], [2, 6, 7, 3], [0, 2, 3, 1], [4, 5, 7, 6]])
    return corners, np.concatenate([quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]]).astype(np.uint32)


def primitive(made: Gltf, positions, faces, **attributes):
    """A primitive as the validator wants it, with bounds of POSITION; attributes are arrays."""
    at = made.accessor(positions, min=positions.min(0).tolist(), max=positions.max(0).tolist())
    return made.primitive(at, faces, attributes={name: made.accessor(rows) for name, rows in attributes.items()})


def scene_file(folder, *meshes, **attributes):
    """A GLB file with one node for each (positions, faces); `attributes` are arrays for all of them."""
    made = Gltf()
    for positions, faces in meshes:
        made.node(mesh=made.mesh(primitive(made, positions, faces, **attributes)))
    return made.write(folder, "scene.glb")
