"""Makes small glTF files, one feature at a time, and computes positions independently of the loader."""

import base64
import io
import json
import struct

import numpy as np

COMPONENT = {"i1": 5120, "u1": 5121, "i2": 5122, "u2": 5123, "u4": 5125, "f4": 5126}
KIND = {1: "SCALAR", 2: "VEC2", 3: "VEC3", 4: "VEC4", 16: "MAT4"}
TRIANGLE = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0]], np.float32)
TETRAHEDRON = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]], np.float32)
TETRAHEDRON_FACES = np.array([[0, 2, 1], [0, 1, 3], [1, 2, 3], [2, 0, 3]], np.uint16)


class Gltf:
    """A glTF file under construction. Methods return the index of the object they added."""

    def __init__(self):
        self.json = {"asset": {"version": "2.0"}, "scene": 0, "scenes": [{"nodes": []}]}
        self.data = bytearray()

    def add(self, key, **fields):
        items = self.json.setdefault(key, [])
        items.append(fields)
        return len(items) - 1

    def view(self, data, **fields):
        self.data += bytes(-len(self.data) % 4)
        start = len(self.data)
        self.data += data
        return self.add("bufferViews", buffer=0, byteOffset=start, byteLength=len(data), **fields)

    def accessor(self, values, **fields):
        """Add an accessor of packed values of the array's dtype.

        (n,) are scalars, (n, k) are vectors, (n, 16) are matrices by columns.
        """
        values = np.ascontiguousarray(values)
        kind = KIND[1 if values.ndim == 1 else values.shape[1]]
        return self.add(
            "accessors",
            bufferView=self.view(values.tobytes()),
            componentType=COMPONENT[values.dtype.str[1:]],
            count=len(values),
            type=kind,
            **fields,
        )

    def primitive(self, positions=TRIANGLE, indices=None, **fields):
        """A primitive as JSON. `positions` is an array or the index of an accessor."""
        attributes = {"POSITION": self._index(positions), **fields.pop("attributes", {})}
        if indices is not None:
            fields["indices"] = self._index(np.asarray(indices).reshape(-1) if np.ndim(indices) else indices)
        return {"attributes": attributes, **fields}

    def mesh(self, *primitives, **fields):
        return self.add("meshes", primitives=list(primitives) or [self.primitive()], **fields)

    def node(self, root=True, **fields):
        index = self.add("nodes", **fields)
        if root:
            self.json["scenes"][0]["nodes"].append(index)
        return index

    def animate(self, node, path, times, values, interpolation="LINEAR", animation=0):
        """Add a channel. `values` are (keys, c), or (keys, 3, c) for CUBICSPLINE."""
        animations = self.json.setdefault("animations", [])
        while len(animations) <= animation:
            animations.append({"channels": [], "samplers": []})
        values = np.asarray(values, np.float32)
        flat = values.reshape(-1) if path == "weights" else values.reshape(-1, values.shape[-1])
        sampler = {
            "input": self.accessor(np.asarray(times, np.float32)),
            "output": self.accessor(flat),
            "interpolation": interpolation,
        }
        target = animations[animation]
        target["samplers"].append(sampler)
        channel = {"sampler": len(target["samplers"]) - 1, "target": {"node": node, "path": path}}
        target["channels"].append(channel)

    def glb(self) -> bytes:
        document = self.document()
        text = json.dumps(document).encode()
        text += b" " * (-len(text) % 4)
        data = bytes(self.data) + bytes(-len(self.data) % 4)
        chunks = struct.pack("<II", len(text), 0x4E4F534A) + text
        chunks += struct.pack("<II", len(data), 0x004E4942) + data
        return struct.pack("<4sII", b"glTF", 2, 12 + len(chunks)) + chunks

    def gltf(self, uri=None) -> bytes:
        """The file as JSON, with the buffer at `uri`, or inside it."""
        document = self.document()
        inside = "data:application/octet-stream;base64," + base64.b64encode(self.data).decode()
        document["buffers"][0]["uri"] = inside if uri is None else uri
        return json.dumps(document).encode()

    def write(self, folder, name="made.glb"):
        path = folder / name
        path.write_bytes(self.glb() if name.endswith(".glb") else self.gltf())
        return path

    def _index(self, values):
        return self.accessor(values) if isinstance(values, np.ndarray) else values

    def document(self):
        return {"buffers": [{"byteLength": len(self.data)}], **self.json} if self.data else dict(self.json)


def single(positions=TRIANGLE, indices=None, **node) -> Gltf:
    """A file with one mesh at one node."""
    made = Gltf()
    made.node(mesh=made.mesh(made.primitive(np.asarray(positions, np.float32), indices)), **node)
    return made


def png(pixels) -> bytes:
    """An (h, w, 3 or 4) uint8 picture as PNG."""
    from PIL import Image

    stream = io.BytesIO()
    Image.fromarray(np.asarray(pixels, np.uint8)).save(stream, "PNG")
    return stream.getvalue()


def world(scene, time=0.0) -> np.ndarray:
    """World positions ((n, 3, 3) float64) of a scene's triangles."""
    triangles = scene.triangles(time)
    return triangles.vertices.astype(np.float64) + triangles.origin


def assert_at(scene, expected, time=0.0):
    """Check that a scene's triangles equal (n, 3, 3) `expected`, up to float32's rounding in the recentred frame."""
    actual = world(scene, time)
    assert actual.shape == np.shape(expected)
    reach = max(np.abs(expected - scene.origin).max(), np.ptp(scene.bounds, axis=0).max())
    np.testing.assert_allclose(actual, expected, rtol=0, atol=reach * 2.0**-23)


def trs(translation=(0, 0, 0), rotation=(0, 0, 0, 1), scale=(1, 1, 1)) -> np.ndarray:
    """A 4 x 4 transform, made with scipy's rotations."""
    from scipy.spatial.transform import Rotation

    matrix = np.eye(4)
    matrix[:3, :3] = Rotation.from_quat(rotation).as_matrix() @ np.diag(scale)
    matrix[:3, 3] = translation
    return matrix


def moved(matrix, points) -> np.ndarray:
    """Points ((..., 3)) under a 4 x 4 transform."""
    return np.asarray(points, np.float64) @ matrix[:3, :3].T + matrix[:3, 3]


def everything() -> Gltf:
    """A file with most features, for mutation."""
    made = Gltf()
    made.json["extensionsUsed"] = ["KHR_lights_punctual", "EXT_mesh_gpu_instancing"]
    image = made.add("images", bufferView=made.view(png(np.full((4, 4, 3), 200))), mimeType="image/png")
    texture = made.add("textures", source=image)
    colour = {"baseColorFactor": [0.5, 0.6, 0.7, 1.0], "baseColorTexture": {"index": texture}}
    material = made.add("materials", pbrMetallicRoughness=colour)
    positions = made.accessor(TETRAHEDRON)
    target = made.accessor(TETRAHEDRON * np.float32(0.5))
    skin_attributes = {
        "JOINTS_0": made.accessor(np.tile(np.array([0, 1, 0, 0], np.uint8), (4, 1))),
        "WEIGHTS_0": made.accessor(np.tile(np.array([0.25, 0.75, 0, 0], np.float32), (4, 1))),
        "COLOR_0": made.accessor(np.full((4, 4), 128, np.uint8), normalized=True),
    }
    sparse = {
        "count": 1,
        "indices": {"bufferView": made.view(np.array([2], np.uint16).tobytes()), "componentType": 5123},
        "values": {"bufferView": made.view(np.array([0, 3, 0], np.float32).tobytes())},
    }
    bent = made.add("accessors", componentType=5126, type="VEC3", count=4, sparse=sparse)
    plain = made.mesh(made.primitive(positions, TETRAHEDRON_FACES, material=material, targets=[{"POSITION": bent}]))
    skinned = made.mesh(
        made.primitive(positions, TETRAHEDRON_FACES, attributes=skin_attributes, targets=[{"POSITION": target}])
    )
    joint = made.node(translation=[0, 1, 0])
    tip = made.node(root=False, rotation=[0, 0, 0, 1], scale=[1, 1, 1])
    made.json["nodes"][joint]["children"] = [tip]
    bind = made.accessor(np.tile(np.eye(4, dtype=np.float32).reshape(1, 16), (2, 1)))
    skin = made.add("skins", joints=[joint, tip], inverseBindMatrices=bind)
    made.node(mesh=skinned, skin=skin, name="skinned", weights=[0.5])
    rows = made.accessor(np.array([[0, 0, 0], [2, 0, 0], [4, 0, 0]], np.float32))
    instancing = {"EXT_mesh_gpu_instancing": {"attributes": {"TRANSLATION": rows}}}
    made.node(mesh=plain, matrix=[1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 3, 0, 0, 1], extensions=instancing)
    camera = made.add("cameras", type="perspective", perspective={"yfov": 0.8, "znear": 0.1, "aspectRatio": 1.5})
    made.node(camera=camera, translation=[0, 0, 9])
    light = {"type": "point", "intensity": 3.0, "color": [1, 0.5, 0.25]}
    made.json["extensions"] = {"KHR_lights_punctual": {"lights": [light]}}
    made.node(extensions={"KHR_lights_punctual": {"light": 0}}, translation=[0, 5, 0])
    made.animate(tip, "rotation", [0, 1, 2], [[0, 0, 0, 1], [0, 0, 0.6, 0.8], [0, 0, 1, 0]])
    made.animate(joint, "translation", [0, 2], np.ones((2, 3, 3)), "CUBICSPLINE")
    made.animate(2, "weights", [0, 1], [[0.0], [1.0]], "STEP", animation=1)
    return made
