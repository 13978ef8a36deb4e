"""Instances: their data, errors, and glTF files whose copies stay instances."""

import json
import pickle

import numpy as np
import pytest

import antumbra as at
from antumbra.cli.scene_arguments import parse_scene
from antumbra.scene.instance_data import InstanceData
from antumbra.scene.scene_bounds import sampled_faces
from antumbra.store.store_format import HEADER, PAGE, meta_to_json
from gltf_files import TETRAHEDRON, TETRAHEDRON_FACES, Gltf, png
from instance_scenes import block, both, random_scenes, random_transforms


def _equal_data(inside, flat):
    """Check that the data of instances are those of the flattened scene, face by face."""
    assert isinstance(inside.data, InstanceData) and not isinstance(flat.data, InstanceData)
    triangles, faces = flat.triangles(), np.random.default_rng(1).permutation(flat.n_triangles).astype(np.int32)
    some = inside.data.some_triangles(faces)
    np.testing.assert_array_equal(some.vertices, triangles.vertices[faces])
    np.testing.assert_array_equal(some.colour, triangles.colour[faces])
    np.testing.assert_array_equal(some.origin, triangles.origin)
    np.testing.assert_array_equal(inside.object_of_face[faces], flat.object_of_face[faces])
    np.testing.assert_array_equal(np.asarray(inside.object_of_face), flat.object_of_face)
    np.testing.assert_array_equal(inside.bounds, flat.bounds)
    assert inside.objects == flat.objects and inside.meshes == flat.meshes
    for copy, box in enumerate(inside.data.boxes):
        world = inside.data.world_corners(np.flatnonzero(flat.object_of_face == copy))
        np.testing.assert_array_equal(box, [world.min((0, 1)), world.max((0, 1))])


def test_instances_have_the_data_of_the_flattened_scene():
    inside, flat = random_scenes(1)
    _equal_data(inside, flat)
    np.testing.assert_array_equal(inside.data.sampled_faces(), sampled_faces(flat.source, flat.n_triangles))
    assert "InstanceData" not in repr(inside) and inside.up == "y"


def test_colours_of_meshes_and_faces():
    colours = np.random.default_rng(2).random((12, 3))
    inside, flat = both([block(), block()], [random_transforms(2, 1), random_transforms(3, 2)], [colours, (1.0, 0, 0)])
    _equal_data(inside, flat)


def test_a_pickled_scene_is_the_same():
    inside, flat = random_scenes(2)
    copy = pickle.loads(pickle.dumps(inside))
    np.testing.assert_array_equal(copy.closest_hit((0, 0, 0), (1, 0, 0)).t, flat.closest_hit((0, 0, 0), (1, 0, 0)).t)


def test_few_copies_are_flattened_unless_asked_for(monkeypatch):
    meshes, transforms = [block()], [random_transforms(4, 3)]
    assert not isinstance(at.Scene.from_instances(meshes, transforms).data, InstanceData)
    monkeypatch.setattr("antumbra.scene.instance_data.FEW_BYTES", 12 * 3 * 256 - 1)
    assert isinstance(at.Scene.from_instances(meshes, transforms).data, InstanceData)


@pytest.mark.parametrize(
    "meshes, transforms, error",
    [
        ([block()], [np.eye(3)[None]], r"transforms of mesh 0 must be numbers \(k, 4, 4\)"),
        ([block()], [np.full((1, 3, 4), np.nan)], "NaN"),
        ([block()], [np.zeros((1, 3, 4))], "instance 0 of mesh .* without inverse"),
        ([block()], [np.eye(4)[None] * 2], "affine"),
        ([block()], [], "1 mesh, 0 arrays of transforms"),
        ([np.zeros((3, 4))], [np.eye(4)[None]], "vertices must be numbers"),
        ([block()], [np.zeros((0, 4, 4))], "no triangles"),
        (block()[0], "x", "transforms is a str"),
    ],
)
def test_errors(meshes, transforms, error):
    for choice in True, False:
        with pytest.raises(at.InputError, match=error):
            at.Scene.from_instances(meshes, transforms, instances=choice)


def test_too_many_triangles():
    with pytest.raises(at.InputError, match="at most 2147483647 fit"):
        at.Scene.from_instances([np.ones((30_000, 3, 3), np.float32)], [np.broadcast_to(np.eye(4), (80_000, 4, 4))])


# --- glTF -------------------------------------------------------------------------------------------------------------


def _wood():
    """A file of two meshes at several nodes, one of them with EXT_mesh_gpu_instancing and two primitives."""
    made, rng = Gltf(), np.random.default_rng(4)
    places = rng.uniform(-9, 9, (5, 3)).astype(np.float32)
    turns = rng.normal(size=(5, 4)).astype(np.float32)
    turns /= np.linalg.norm(turns, axis=1, keepdims=True)
    attributes = {"TRANSLATION": made.accessor(places), "ROTATION": made.accessor(turns)}
    tree = made.mesh(made.primitive(TETRAHEDRON, TETRAHEDRON_FACES), made.primitive(2 * TETRAHEDRON[:3]), name="tree")
    stone = made.mesh(made.primitive(TETRAHEDRON * np.array([1, -2, 1], np.float32), TETRAHEDRON_FACES), name="stone")
    made.node(mesh=stone, translation=[1, 2, 3], scale=[1, -2, 0.5])
    made.node(
        mesh=tree, name="row", extensions={"EXT_mesh_gpu_instancing": {"attributes": attributes}}, scale=[2, 1, 1]
    )
    child = made.node(root=False, mesh=tree, rotation=[0, 0.6, 0, 0.8])
    made.node(mesh=stone, children=[child], translation=[-4, 0, 1], scale=[3, 3, 3])
    return made


def test_nodes_that_share_a_mesh_stay_instances(tmp_path):
    path = _wood().write(tmp_path)
    inside, flat = (at.load(path, instances=choice) for choice in (True, None))
    _equal_data(inside, flat)
    assert len(inside.data.instances.meshes) == 2
    rng = np.random.default_rng(5)
    origins, directions = rng.uniform(*flat.bounds, (2000, 3)), rng.normal(size=(2000, 3))
    hit, other = (scene.closest_hit(origins, directions) for scene in (inside, flat))
    for name in ("face", "t", "u", "v", "object"):
        np.testing.assert_array_equal(getattr(hit, name), getattr(other, name))
    assert hit.mask.mean() > 0.03


def test_morphed_and_skinned_nodes_have_meshes_of_their_own(tmp_path):
    made = _wood()
    target = made.accessor(np.full((4, 3), 0.5, np.float32))
    mesh = made.mesh(made.primitive(TETRAHEDRON, TETRAHEDRON_FACES, targets=[{"POSITION": target}]), weights=[0.7])
    made.node(mesh=mesh, translation=[0, 5, 0])
    made.node(mesh=mesh, weights=[0.1])
    joint = made.node(translation=[7, 0, 0], rotation=[0.6, 0, 0, 0.8])
    skin = made.add("skins", joints=[joint])
    attributes = {
        "JOINTS_0": made.accessor(np.zeros((4, 4), np.uint8)),
        "WEIGHTS_0": made.accessor(np.full((4, 4), 0.25, np.float32)),
    }
    skinned = made.mesh(made.primitive(TETRAHEDRON, TETRAHEDRON_FACES, attributes=attributes))
    made.node(mesh=skinned, skin=skin, scale=[4, 4, 4])
    path = made.write(tmp_path)
    _equal_data(*(at.load(path, instances=choice) for choice in (True, False)))


def test_what_moves_or_lets_light_pass_is_flattened(tmp_path, monkeypatch):
    monkeypatch.setattr("antumbra.scene.instance_data.FEW_BYTES", 0)
    made = _wood()
    assert isinstance(at.load(made.write(tmp_path)).data, InstanceData)
    assert not isinstance(at.load(made.write(tmp_path), transmittance={"*": 0.5}).data, InstanceData)
    made.animate(0, "translation", [0.0, 1.0], [[0, 0, 0], [1, 0, 0]])
    assert not isinstance(at.load(made.write(tmp_path)).data, InstanceData)
    with pytest.raises(at.InputError, match="animated; leave it out"):
        at.load(made.write(tmp_path), instances=True)


def test_alpha_needs_flattened_copies(tmp_path, monkeypatch):
    monkeypatch.setattr("antumbra.scene.instance_data.FEW_BYTES", 0)
    made = Gltf()
    material = made.add("materials", alphaMode="BLEND", pbrMetallicRoughness={"baseColorFactor": [1, 1, 1, 0.3]})
    mesh = made.mesh(made.primitive(TETRAHEDRON, TETRAHEDRON_FACES, material=material))
    for x in range(3):
        made.node(mesh=mesh, translation=[2 * x, 0, 0])
    path = made.write(tmp_path)
    assert not isinstance(at.load(path).data, InstanceData)
    with pytest.raises(at.InputError, match="lets light pass"):
        at.load(path, instances=True)
    solid = at.load(path, cutouts=False)
    assert isinstance(solid.data, InstanceData)
    with pytest.raises(at.InputError, match="instances are solid"):
        solid.set_transmittance({"*": 0.5})


def test_textured_instances_have_mean_colours_and_a_note(tmp_path):
    made = Gltf()
    image = made.add("images", bufferView=made.view(png(np.full((2, 2, 3), 128))), mimeType="image/png")
    texture = {"baseColorTexture": {"index": made.add("textures", source=image)}}
    material = made.add("materials", pbrMetallicRoughness=texture)
    uv = {"TEXCOORD_0": made.accessor(TETRAHEDRON[:, :2].copy())}
    mesh = made.mesh(made.primitive(TETRAHEDRON, TETRAHEDRON_FACES, material=material, attributes=uv))
    made.node(mesh=mesh)
    made.node(mesh=mesh, translation=[3, 0, 0])
    path = made.write(tmp_path)
    with pytest.warns(UserWarning, match="one colour per face"):
        inside = at.load(path, instances=True)
    assert inside.appearance is None
    _equal_data(inside, at.load(path))
    view = at.Camera((1, 1, 6), (1, 0, 0), width=20, height=16), [at.DirectionalLight((0, -1, -1))]
    pictures = [at.render(inside, *view, spp=1, plan=plan).image for plan in (None, "bsah+single")]
    np.testing.assert_array_equal(*pictures)


def test_the_command_line_chooses_instances(tmp_path):
    assert parse_scene("a.glb?instances=on").instances is True
    assert parse_scene("a.glb?instances=off&cutouts=off").instances is False
    assert parse_scene("a.glb").instances is None
    with pytest.raises(at.InputError, match="instances is 'maybe'"):
        parse_scene("a.glb?instances=maybe")
    path = tmp_path / "points.obj"
    path.write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n")
    with pytest.raises(at.InputError, match="has no instances"):
        at.load(path, instances=True)


def test_a_store_of_instances_holds_all_copies(tmp_path):
    from antumbra.engine.store_building import build_store

    inside, flat = random_scenes(6)
    paths = [tmp_path / f"{name}.antumbra" for name in ("inside", "flat")]
    for scene, path in zip((inside, flat), paths):
        build_store([scene], path)
    stores, whole = [at.load(path).store for path in paths], [path.read_bytes() for path in paths]
    directories = [HEADER.unpack_from(each)[4] for each in whole]
    assert whole[0][PAGE : directories[0]] == whole[1][PAGE : directories[1]]
    metas = [json.loads(meta_to_json(store.meta)) for store in stores]
    assert metas[1].pop("detail") and metas[0] == metas[1]  # copies of meshes are shown from outside


def test_results_of_instances_are_recognised(tmp_path):
    from antumbra.work.scene_records import scene_digest

    digests = [scene_digest(scene, 0.0) for scene in (random_scenes(7)[0], random_scenes(7)[0], random_scenes(8)[0])]
    assert digests[0] == digests[1] != digests[2]


def test_views_of_data_sets_are_those_of_the_flattened_scene(monkeypatch):
    from antumbra.datasets import random_views

    monkeypatch.setattr(random_views, "_MANY", 10)
    monkeypatch.setattr(random_views, "_ENOUGH", 100)
    inside, flat = random_scenes(9)
    regions = [random_views.sampling_region(scene, 0.0, 2) for scene in (inside, flat)]
    np.testing.assert_array_equal(regions[0].bounds, regions[1].bounds)
    assert "_flat" not in vars(inside.data) and (regions[0].bounds != flat.bounds).any()
