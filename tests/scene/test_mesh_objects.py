"""Objects of scenes: which faces belong to which node or instance, checked by where the faces are."""

import numpy as np
import pytest

from antumbra.engine.scene import Scene, procedural
from antumbra.engine.scene_loading import load
from antumbra.engine.store_building import build_store
from antumbra.scene import instances
from antumbra.scene.mesh import ObjectInfo
from gltf_files import TETRAHEDRON, TETRAHEDRON_FACES, TRIANGLE, Gltf
from scenes import scene_path


def summary(scene) -> list[tuple[str, int, int]]:
    """Name, mesh and instance of each object."""
    return [(each.name, each.mesh, each.instance) for each in scene.objects]


def places(scene) -> list[set[int]]:
    """For each object, the tens of x at which its faces are."""
    triangles = scene.triangles()
    x = np.round((triangles.vertices.astype(np.float64) + triangles.origin)[..., 0].min(axis=1) / 10.0).astype(int)
    return [set(x[scene.object_of_face == k].tolist()) for k in range(len(scene.objects))]


def test_each_node_is_an_object_with_all_its_primitives(tmp_path):
    made = Gltf()
    parts = made.primitive(TETRAHEDRON, TETRAHEDRON_FACES), made.primitive()
    both, single = made.mesh(*parts, name="both"), made.mesh(name="single")
    unused = made.mesh(name="unused")
    made.node(mesh=both, name="left")
    made.node(mesh=single, translation=[10, 0, 0])
    made.node(mesh=both, translation=[20, 0, 0])
    made.node(root=False, mesh=unused)
    scene = load(made.write(tmp_path))
    assert summary(scene) == [("left", 0, 0), ("single", 1, 0), ("both", 0, 1)]
    assert [m.name for m in scene.meshes] == ["both", "single"]
    assert scene.object_of_face.tolist() == [0] * 5 + [1] + [2] * 5
    assert scene.object_of_face.dtype == np.int32
    assert places(scene) == [{0}, {1}, {2}]


@pytest.mark.parametrize("batch", [1, 1 << 18])
def test_each_copy_of_an_instanced_node_is_an_object(tmp_path, monkeypatch, batch):
    monkeypatch.setattr(instances, "VERTEX_BATCH", batch)
    made = Gltf()
    at = made.accessor(np.array([[10, 0, 0], [20, 0, 0], [30, 0, 0]], np.float32))
    mesh = made.mesh(made.primitive(TETRAHEDRON, TETRAHEDRON_FACES), made.primitive(), name="tree")
    made.node(mesh=mesh)
    made.node(mesh=mesh, name="row", extensions={"EXT_mesh_gpu_instancing": {"attributes": {"TRANSLATION": at}}})
    scene = load(made.write(tmp_path))
    assert summary(scene) == [("tree", 0, 0), ("row[0]", 0, 1), ("row[1]", 0, 2), ("row[2]", 0, 3)]
    assert scene.object_of_face.tolist() == [0] * 5 + [1] * 4 + [2] * 4 + [3] * 4 + [1, 2, 3]
    assert places(scene) == [{0}, {1}, {2}, {3}]


def test_each_material_of_an_obj_file_is_an_object(tmp_path):
    vertices = "".join(f"v {x} {y} 0\n" for x in (0, 10) for y in (0, 1, 2)) + "v 25 5 0\n"
    (tmp_path / "two.mtl").write_text("newmtl stone\nKd 1 0 0\nnewmtl wood\nKd 0 1 0\n")
    (tmp_path / "two.obj").write_text(
        f"mtllib two.mtl\n{vertices}usemtl stone\nf 1 2 7\nf 2 3 7\nusemtl wood\nf 4 5 7\n"
    )
    scene = load(tmp_path / "two.obj")
    at = {o.name: (scene.meshes[o.mesh].triangles, x) for o, x in zip(scene.objects, places(scene))}
    assert at == {"stone": (2, {0}), "wood": (1, {1})}


def test_arrays_frames_and_procedural_scenes_are_one_object(tmp_path):
    np.save(tmp_path / "frames.npy", TRIANGLE[None])
    np.save(tmp_path / "faces.npy", np.array([[0, 1, 2]]))
    for scene in Scene.from_arrays(TRIANGLE[None]), load(tmp_path), procedural("atrium", triangles=2000):
        assert scene.objects == [ObjectInfo(scene.name, 0, 0)]
        assert scene.object_of_face.tolist() == [0] * scene.n_triangles


def test_a_store_is_one_object(tmp_path):
    build_store([Scene.from_arrays(TRIANGLE[None] + np.zeros((70, 1, 1)))], tmp_path / "made.antumbra")
    scene = load(tmp_path / "made.antumbra")
    assert scene.objects == [ObjectInfo("arrays", -1, 0)]
    assert scene.object_of_face.tolist() == [0] * 70 and scene.object_of_face.dtype == np.int32


def test_objects_of_a_real_scene():
    scene = load(scene_path("godot_room/scene.glb"))
    counts = np.bincount(scene.object_of_face, minlength=len(scene.objects))
    assert counts.tolist() == [scene.meshes[o.mesh].triangles for o in scene.objects]
    assert len(scene.objects) == sum(m.instances for m in scene.meshes) > 1
