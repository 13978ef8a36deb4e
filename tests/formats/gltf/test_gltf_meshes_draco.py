"""Meshes compressed with Draco give the scene of the uncompressed file."""

import sys

import DracoPy
import numpy as np
import pytest

import antumbra as at
from gltf_files import Gltf, png

EXTENSION = "KHR_draco_mesh_compression"


def textured(packed: bool) -> Gltf:
    rng = np.random.default_rng(1)
    points = rng.normal(size=(40, 3)).astype(np.float32)
    faces = np.array([[i, i + 1, i + 2] for i in range(38)], np.uint32)
    uv, normals = rng.random((40, 2), np.float32), points / np.linalg.norm(points, axis=1, keepdims=True)
    made = Gltf()
    texture = made.add("images", bufferView=made.view(png(rng.integers(0, 256, (8, 8, 3)))), mimeType="image/png")
    look = {"baseColorTexture": {"index": made.add("textures", source=texture)}}
    material = made.add("materials", pbrMetallicRoughness=look)
    attributes = {"TEXCOORD_0": made.accessor(uv), "NORMAL": made.accessor(normals)}
    primitive = made.primitive(points, faces, attributes=attributes, material=material)
    if packed:
        double = {"tex_coord": uv.astype(float), "normals": normals.astype(float)}
        data = DracoPy.encode(points, faces, 0, 5, preserve_order=True, **double)
        mesh = DracoPy.decode(data)
        of_type = lambda kind: mesh.get_attribute_by_type(kind)["unique_id"]
        kinds = DracoPy.AttributeType
        ids = {"POSITION": kinds.POSITION, "TEXCOORD_0": kinds.TEX_COORD, "NORMAL": kinds.NORMAL}
        numbers = {name: of_type(kind) for name, kind in ids.items()}
        primitive["extensions"] = {EXTENSION: {"bufferView": made.view(data), "attributes": numbers}}
        for index in (*primitive["attributes"].values(), primitive["indices"]):
            del made.json["accessors"][index]["bufferView"]
        made.json |= {"extensionsUsed": [EXTENSION], "extensionsRequired": [EXTENSION]}
    made.node(mesh=made.mesh(primitive))
    return made


def test_a_compressed_mesh_is_the_same_scene(tmp_path):
    packed, plain = (at.load(textured(p).write(tmp_path, f"{p}.glb")) for p in (True, False))
    order = lambda scene: np.lexsort(scene.triangles().vertices.mean(1).round(5).T)
    a, b = order(packed), order(plain)
    np.testing.assert_allclose(packed.triangles().vertices[a].mean(1), plain.triangles().vertices[b].mean(1), atol=1e-4)
    np.testing.assert_allclose(packed.colours[a], plain.colours[b], atol=1e-5)
    for name in ("uv", "normals"):
        first, second = (getattr(s.appearance, name)[i].sum((1, 2)) for s, i in ((packed, a), (plain, b)))
        if name == "uv":  # corners may be turned, which changes the frame of normals but not these sums
            np.testing.assert_allclose(first, second, atol=1e-3)
    assert packed.appearance.normals.any()


def test_without_the_library_the_cure_is_named(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "DracoPy", None)
    with pytest.raises(
        at.InputError, match=r"compressed with Draco, needs DracoPy: pip install 'antumbra\[compressed\]'"
    ):
        at.load(textured(True).write(tmp_path))
