"""GLB files that the writer makes, read back independently."""

import numpy as np
import pytest

import antumbra as at
from antumbra.formats.gltf.gltf_writer import GltfWriter, up_axis_transform
from baked_files import Glb
from gltf_files import TETRAHEDRON, TETRAHEDRON_FACES, assert_at


def written(writer, folder):
    (folder / "a.glb").write_bytes(writer.glb())
    return Glb(folder / "a.glb")


def test_a_new_file_is_a_scene(tmp_path):
    writer = GltfWriter()
    colours = np.random.default_rng(0).random((4, 3))
    material = writer.add("materials", writer.make_unlit({}))
    primitive = writer.primitive(TETRAHEDRON, TETRAHEDRON_FACES, colours, material=material)
    writer.add_root({"mesh": writer.add("meshes", {"primitives": [primitive]}), **up_axis_transform("z")})
    glb = written(writer, tmp_path)
    np.testing.assert_array_equal(glb.attribute("COLOR_0"), colours.astype(np.float32))
    position = glb.json["accessors"][primitive["attributes"]["POSITION"]]
    assert position["min"] == TETRAHEDRON.min(0).tolist() and position["max"] == TETRAHEDRON.max(0).tolist()
    assert glb.json["extensionsUsed"] == ["KHR_materials_unlit"] and glb.json["scenes"] == [{"nodes": [0]}]
    assert_at(at.load(tmp_path / "a.glb", up="y"), TETRAHEDRON[TETRAHEDRON_FACES][..., [0, 2, 1]] * (1, 1, -1))


@pytest.mark.parametrize("width, kind", [(1, "u1"), (3, "u1"), (3, "<u2"), (4, "<u2"), (2, "<f4")])
@pytest.mark.parametrize("count", [1, 5])
def test_rows_are_aligned_to_four_bytes(tmp_path, width, kind, count):
    writer, rows = GltfWriter(), (7 * np.arange(count * width) % 256).astype(kind).reshape(count, width)
    writer.view(b"odd")
    for _ in range(2):
        writer.accessor(rows)
    glb = written(writer, tmp_path)
    assert len(glb.binary) % 4 == 0 and all(view["byteOffset"] % 4 == 0 for view in glb.json["bufferViews"])
    assert all(view.get("byteStride", 4) % 4 == 0 for view in glb.json["bufferViews"])
    np.testing.assert_array_equal(glb.array(1).reshape(count, width), rows)


def test_names_are_utf_8(tmp_path):
    writer = GltfWriter()
    writer.add_root({"name": "größe"})
    assert "größe".encode() in writer.glb() and written(writer, tmp_path).json["nodes"][0]["name"] == "größe"
