"""glTF geometry: hierarchy, instances, primitive modes, accessors of every kind."""

import json

import numpy as np
import pytest

from antumbra.base.errors import InputError
from antumbra.engine.scene_loading import load
from gltf_files import TETRAHEDRON, TETRAHEDRON_FACES, TRIANGLE, Gltf, assert_at, moved, single, trs

Q = np.array([0.2, -0.4, 0.1, 0.8]) / np.linalg.norm([0.2, -0.4, 0.1, 0.8])


def test_nodes_multiply_from_the_root_down(tmp_path):
    made = Gltf()
    mesh = made.mesh()
    leaf = made.node(root=False, mesh=mesh, translation=[1, 2, 3], rotation=Q.tolist(), scale=[1, 2, -0.5])
    column_major = [0, 0, -2, 0, 0, 2, 0, 0, 2, 0, 0, 0, 5, 6, 7, 1]
    middle = made.node(root=False, matrix=column_major, children=[leaf])
    made.node(scale=[3, 3, 3], children=[middle])
    matrix = trs(scale=(3, 3, 3)) @ np.array(column_major, float).reshape(4, 4).T @ trs((1, 2, 3), Q, (1, 2, -0.5))
    assert_at(load(made.write(tmp_path)), moved(matrix, TRIANGLE)[None])


def test_rotations_that_are_not_of_unit_length_do_not_scale(tmp_path):
    made = single(TETRAHEDRON, TETRAHEDRON_FACES, rotation=(3.0 * Q).tolist())
    assert_at(load(made.write(tmp_path)), moved(trs(rotation=Q), TETRAHEDRON[TETRAHEDRON_FACES]))


def test_a_mesh_at_several_nodes_is_instanced_in_the_order_of_nodes(tmp_path):
    made = Gltf()
    mesh = made.mesh(made.primitive(TETRAHEDRON, TETRAHEDRON_FACES), name="shape")
    offsets = [(0, 0, 0), (5, 0, 0), (0, 7, 0)]
    for offset in offsets:
        made.node(mesh=mesh, translation=list(offset))
    scene = load(made.write(tmp_path))
    expected = [TETRAHEDRON[TETRAHEDRON_FACES] + np.array(o, float) for o in offsets]
    assert_at(scene, np.concatenate(expected))
    assert scene.meshes == [("shape", 4, 3)]


def test_only_the_default_scene_is_shown(tmp_path):
    made = Gltf()
    mesh = made.mesh()
    made.node(mesh=mesh)
    other = made.node(root=False, mesh=mesh, translation=[0, 0, 9])
    made.json["scenes"].append({"nodes": [other]})
    made.json["scene"] = 1
    assert_at(load(made.write(tmp_path)), TRIANGLE[None] + (0, 0, 9.0))
    del made.json["scene"]
    assert_at(load(made.write(tmp_path)), TRIANGLE[None])
    del made.json["scenes"]
    assert load(made.write(tmp_path)).n_triangles == 2


@pytest.mark.parametrize("indexed", [False, True])
@pytest.mark.parametrize("mode", [4, 5, 6])
def test_triangles_strips_and_fans(tmp_path, mode, indexed):
    points = np.random.default_rng(mode).normal(size=(6, 3)).astype(np.float32)
    order = np.array([3, 1, 0, 5, 4, 2], np.uint8) if indexed else None
    corners = points if order is None else points[order]
    if mode == 4:
        expected = [(0, 1, 2), (3, 4, 5)]
    elif mode == 5:  # every second triangle is flipped, so that all have the same winding
        expected = [(0, 1, 2), (1, 3, 2), (2, 3, 4), (3, 5, 4)]
    else:
        expected = [(i + 1, i + 2, 0) for i in range(4)]
    made = Gltf()
    made.node(mesh=made.mesh(made.primitive(points, order, mode=mode)))
    assert_at(load(made.write(tmp_path)), corners[np.array(expected)])


def test_points_lines_and_empty_primitives_are_passed_over(tmp_path):
    made = Gltf()
    empty = made.add("accessors", componentType=5126, type="VEC3", count=0)
    skipped = [made.primitive(TRIANGLE, mode=m) for m in (0, 1, 2, 3)] + [made.primitive(empty)]
    made.node(mesh=made.mesh(*skipped, made.primitive(TETRAHEDRON, TETRAHEDRON_FACES)))
    assert load(made.write(tmp_path)).n_triangles == 4


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16, np.uint32])
def test_index_widths(tmp_path, dtype):
    path = single(TETRAHEDRON, TETRAHEDRON_FACES.astype(dtype)).write(tmp_path)
    assert_at(load(path), TETRAHEDRON[TETRAHEDRON_FACES])


@pytest.mark.parametrize("dtype", [np.int8, np.uint8, np.int16, np.uint16])
@pytest.mark.parametrize("normalized", [False, True])
def test_quantised_positions(tmp_path, dtype, normalized):
    top = np.iinfo(dtype).max
    stored = np.array([[0, 0, 0], [top, 0, 3], [0, top // 2, np.iinfo(dtype).min]], dtype)
    made = Gltf()
    made.json["extensionsRequired"] = ["KHR_mesh_quantization"]
    made.node(mesh=made.mesh(made.primitive(made.accessor(stored, normalized=normalized))))
    expected = np.maximum(stored / float(top), -1.0) if normalized else stored.astype(float)
    assert_at(load(made.write(tmp_path)), expected[None])


def test_interleaved_attributes(tmp_path):
    rows = np.zeros(3, dtype=[("position", "<f4", 3), ("other", "<f4", 5)])
    rows["position"], rows["other"] = TRIANGLE + 2, np.nan
    made = Gltf()
    view = made.view(b"\xff\xff\xff\xff" + rows.tobytes(), byteStride=32)
    accessor = made.add("accessors", bufferView=view, byteOffset=4, componentType=5126, count=3, type="VEC3")
    made.node(mesh=made.mesh(made.primitive(accessor)))
    assert_at(load(made.write(tmp_path)), TRIANGLE[None] + 2.0)


@pytest.mark.parametrize("over_zero", [False, True])
def test_sparse_accessors(tmp_path, over_zero):
    made = Gltf()
    base = {} if over_zero else {"bufferView": made.view(TRIANGLE.tobytes())}
    rows, values = np.array([0, 2], np.uint8), np.array([[4, 5, 6], [7, 8, 10]], np.float32)
    sparse = {
        "count": 2,
        "indices": {"bufferView": made.view(rows.tobytes()), "componentType": 5121},
        "values": {"bufferView": made.view(values.tobytes())},
    }
    accessor = made.add("accessors", componentType=5126, count=3, type="VEC3", sparse=sparse, **base)
    made.node(mesh=made.mesh(made.primitive(accessor)))
    expected = np.zeros((3, 3)) if over_zero else TRIANGLE.astype(float)
    expected[rows] = values
    assert_at(load(made.write(tmp_path)), expected[None])


def test_gpu_instancing(tmp_path):
    rng = np.random.default_rng(3)
    shift, scale = rng.normal(size=(5, 3)).astype(np.float32), rng.uniform(0.5, 2, (5, 3)).astype(np.float32)
    turn = rng.normal(size=(5, 4))
    turn = (turn / np.linalg.norm(turn, axis=1, keepdims=True)).astype(np.float32)
    made = Gltf()
    attributes = {
        "TRANSLATION": made.accessor(shift),
        "ROTATION": made.accessor(turn),
        "SCALE": made.accessor(scale),
    }
    mesh = made.mesh(made.primitive(TETRAHEDRON, TETRAHEDRON_FACES))
    made.node(mesh=mesh, translation=[0, 0, 4], extensions={"EXT_mesh_gpu_instancing": {"attributes": attributes}})
    node = trs((0, 0, 4))
    each = [moved(node @ trs(t, r, s), TETRAHEDRON[TETRAHEDRON_FACES]) for t, r, s in zip(shift, turn, scale)]
    scene = load(made.write(tmp_path))
    assert_at(scene, np.concatenate(each))
    assert scene.meshes[0].instances == 5


def test_vertices_that_no_face_uses_do_not_count(tmp_path):
    points = np.concatenate([np.full((2, 3), np.nan), TRIANGLE, np.full((1, 3), 1e9)]).astype(np.float32)
    scene = load(single(points, np.array([2, 3, 4], np.uint16)).write(tmp_path))
    assert_at(scene, TRIANGLE[None])
    np.testing.assert_array_equal(scene.bounds, [[0, 0, 0], [1, 1, 0]])


def test_zero_area_triangles_are_kept(tmp_path):
    faces = np.array([[0, 0, 0], [0, 1, 2], [1, 1, 2]], np.uint16)
    assert_at(load(single(TRIANGLE, faces).write(tmp_path)), TRIANGLE[faces])


def test_the_same_from_glb_data_uri_and_external_buffer(tmp_path):
    made = single(TETRAHEDRON, TETRAHEDRON_FACES, rotation=Q.tolist())
    (tmp_path / "sub dir").mkdir()
    (tmp_path / "sub dir" / "a.bin").write_bytes(made.data)
    (tmp_path / "beside.gltf").write_bytes(made.gltf("sub%20dir/a.bin"))
    (tmp_path / "turned.glb").write_bytes(made.gltf())  # the content decides the format, not the suffix
    scenes = [load(made.write(tmp_path)), load(made.write(tmp_path, "inside.gltf"))]
    scenes += [load(tmp_path / "beside.gltf"), load(str(tmp_path / "turned.glb"))]
    for scene in scenes[1:]:
        np.testing.assert_array_equal(scene.triangles().vertices, scenes[0].triangles().vertices)
    assert [s.name for s in scenes] == ["made", "inside", "beside", "turned"]


def test_a_node_far_away_keeps_its_precision(tmp_path):
    near = load(single(TETRAHEDRON, TETRAHEDRON_FACES).write(tmp_path, "near.glb"))
    far = load(single(TETRAHEDRON, TETRAHEDRON_FACES, translation=[5e6, 4.5e5, -3e6]).write(tmp_path, "far.glb"))
    np.testing.assert_array_equal(near.triangles().vertices, far.triangles().vertices)
    np.testing.assert_array_equal(far.origin - near.origin, [5e6, 4.5e5, -3e6])


def test_unused_extensions_do_no_harm_and_unknown_required_ones_are_named(tmp_path):
    made = single()
    made.json["extensionsUsed"] = ["VENDOR_strange"]
    made.json["extensionsRequired"] = ["KHR_materials_unlit", "KHR_texture_transform"]
    assert load(made.write(tmp_path)).n_triangles == 1
    made.json["extensionsRequired"] = ["VENDOR_strange"]
    with pytest.raises(InputError, match="VENDOR_strange"):
        load(made.write(tmp_path))


def test_shared_vertices_of_many_primitives(tmp_path):
    points = np.random.default_rng(0).normal(size=(300, 3)).astype(np.float32)
    made = Gltf()
    accessor = made.accessor(points)
    faces = np.arange(300, dtype=np.uint16).reshape(-1, 3)[::-1].copy()
    made.node(mesh=made.mesh(*(made.primitive(accessor, f) for f in faces)))
    assert_at(load(made.write(tmp_path)), points[faces])


def test_face_ids_and_colours_line_up(tmp_path):
    made = Gltf()
    red, blue = (
        made.add("materials", pbrMetallicRoughness={"baseColorFactor": c}) for c in ([1, 0, 0, 1], [0, 0, 0.5, 1])
    )
    made.node(mesh=made.mesh(made.primitive(TETRAHEDRON, TETRAHEDRON_FACES, material=red), made.primitive()))
    made.node(mesh=made.mesh(made.primitive(material=blue)), translation=[0, 0, 1])
    triangles = load(made.write(tmp_path)).triangles()
    np.testing.assert_array_equal(triangles.face_id, np.arange(6))
    assert triangles.face_id.dtype == np.int32 and triangles.colour.dtype == np.float32
    np.testing.assert_array_equal(triangles.colour, [[1, 0, 0]] * 4 + [[1, 1, 1]] + [[0, 0, 0.5]])


def test_json_with_a_byte_order_mark(tmp_path):
    path = tmp_path / "bom.gltf"
    path.write_bytes(b"\xef\xbb\xbf" + single().gltf())
    assert load(path).n_triangles == 1
    assert json.loads(single().gltf())["asset"]["version"] == "2.0"
