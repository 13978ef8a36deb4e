"""A baked file holds nothing that only its input used, and all else is there."""

import json

import DracoPy
import numpy as np
import pytest

import antumbra as at
from antumbra.formats.gltf.gltf_asset import prune, used_in
from baked_files import KIND, WIDTH, Glb, box, grid, primitive
from formats.gltf.test_gltf_meshes_draco import EXTENSION, textured
from gltf_files import Gltf, everything, png

BAKES = [
    {},
    {"texture": 32},
    {"what": "light", "texture": 32},
    {"what": "light", "texture": 32, "unlit": True},
    {"texture": 32, "uv": 0},
]


def model(folder, **more):
    """Two meshes with textures, one of them in a shared buffer view between others, and what the file never uses."""
    made = Gltf()
    looks = []
    for shade in (60, 200):
        image = made.add("images", bufferView=made.view(png(np.full((5, 5, 3), shade))), mimeType="image/png")
        texture = made.add("textures", source=image, sampler=made.add("samplers", wrapS=10497))
        looks.append(made.add("materials", pbrMetallicRoughness={"baseColorTexture": {"index": texture}}))
    uv = np.array([[0, 0], [0, 1], [1, 0], [1, 1]], np.float32)
    floor = {**primitive(made, *grid([0, 4], [0, 4]), TEXCOORD_0=uv), "material": looks[0]}
    lines = {**primitive(made, *grid([5, 6], [5, 6])), "mode": 1, "material": looks[1]}
    made.accessor(np.arange(9, dtype=np.float32))  # of nothing
    made.node(mesh=made.mesh(floor, lines))
    (points, faces), other = box((1, 0.5, 1), (3, 1.5, 3)), np.arange(24, dtype=np.float32).reshape(8, 3)
    view = made.view(np.concatenate([other, points, other + 1]).tobytes(), byteStride=12)
    places = [
        made.add(
            "accessors", bufferView=view, byteOffset=96 * k, componentType=5126, count=8, type="VEC3",
            min=values.min(0).tolist(), max=values.max(0).tolist(),
        )
        for k, values in enumerate((other, points, other + 1))
    ]  # fmt: skip
    solid = made.primitive(places[1], faces, material=looks[1], targets=[{"POSITION": places[0]}])
    solid["attributes"]["TEXCOORD_0"] = made.accessor(np.random.default_rng(0).random((8, 2), np.float32) / 9)
    made.node(mesh=made.mesh(solid, weights=[0.0]), name="moving")
    joint = made.add("skins", joints=[0], inverseBindMatrices=made.accessor(np.eye(4, dtype="f4").reshape(1, 16)))
    assert joint == 0
    made.animate(1, "translation", [0.0, 1.0], [[0, 0, 0], [1, 0, 0]])
    made.json |= more
    return made.write(folder, "model.glb")


def extent(glb):
    """Bytes that the accessors and images of a file need, without padding."""
    views = glb.json["bufferViews"]
    images = sum(views[image["bufferView"]]["byteLength"] for image in glb.json.get("images", []))
    row = lambda a: WIDTH[a["type"]] * np.dtype(KIND[a["componentType"]]).itemsize if a["type"] in WIDTH else 64
    return images + sum(a["count"] * (row(a) + -row(a) % 4 * (a["type"] != "SCALAR")) for a in glb.json["accessors"])


def shown(path):
    """Triangles and mean colours of a file, in order, at two moments."""
    scene = at.load(path)
    corners = [scene.triangles(time).vertices + scene.origin for time in (0.0, 0.75)]
    return corners, scene.colours


@pytest.mark.parametrize("options", BAKES)
def test_nothing_dead_is_left_and_all_else_is_there(tmp_path, options):
    pytest.importorskip("xatlas")
    path = model(tmp_path)
    at.bake(path, tmp_path / "out.glb", spp=4, **options)
    before, after = Glb(path), Glb(tmp_path / "out.glb")
    used = used_in(after.json)
    for name, kept in used.items():
        unused = set(range(len(after.json[name]))) - kept
        assert len(unused) == (2 if name == "accessors" else 0), (name, unused)  # those that the file itself never used
    size = after.json["buffers"][0]["byteLength"]
    assert extent(after) <= size <= extent(after) + 4 * (len(after.json["bufferViews"]) + 1)
    for (a, b), moment in zip(zip(*(shown(p)[0] for p in (path, tmp_path / "out.glb"))), (0.0, 0.75)):
        np.testing.assert_array_equal(a, b, err_msg=str(moment))
    idle = sorted(set(range(len(after.json["accessors"]))) - used["accessors"])
    np.testing.assert_array_equal(after.array(idle[0])[:, 0], np.arange(9))
    np.testing.assert_array_equal(after.array(idle[1]), np.arange(24).reshape(8, 3) + 1)
    lines = after.json["meshes"][0]["primitives"][1]
    np.testing.assert_array_equal(after.array(lines["attributes"]["POSITION"]), grid([5, 6], [5, 6])[0])
    if "unlit" in options:
        images = [before.image(1), *(after.image(k) for k in range(len(after.json["images"])))]
        assert any(image.shape == (5, 5, 3) and (image == images[0]).all() for image in images[1:])  # of the lines
        assert not any((image == before.image(0)).all() for image in images[1:] if image.shape == (5, 5, 3))


@pytest.mark.parametrize("data, whole", [({"table": 0}, True), ({"name": "x", "on": True}, False)])
def test_a_file_with_unknown_numbers_stays_whole(tmp_path, data, whole):
    pytest.importorskip("xatlas")
    path = model(tmp_path, extensions={"X_own": data}, extensionsUsed=["X_own"])
    at.bake(path, tmp_path / "out.glb", spp=4, texture=32)
    before, after = Glb(path), Glb(tmp_path / "out.glb")
    assert (after.json["accessors"][: len(before.json["accessors"])] == before.json["accessors"]) == whole
    assert after.json["extensions"] == {"X_own": data}


def test_pruning_twice_changes_nothing():
    root = json.loads(json.dumps(everything().document()))
    lengths = {name: len(root.get(name, [])) for name in used_in(root)}
    data = bytes(everything().data)
    assert prune(root, data, lengths, used_in(root)) == (root, data)
    extended = {**root, "accessors": [*root["accessors"], {"componentType": 5126, "count": 1, "type": "SCALAR"}]}
    assert prune(extended, data, lengths, used_in(root)) == (root, data)


@pytest.mark.parametrize("options", [{}, {"texture": 64}])
def test_a_bake_reads_draco(tmp_path, options):
    pytest.importorskip("xatlas")
    path = textured(True).write(tmp_path)
    report = at.bake(path, tmp_path / "out.glb", spp=4, what="light", lights=at.PointLight((0, 9, 0)), **options)
    glb, text = Glb(tmp_path / "out.glb"), json.dumps(Glb(tmp_path / "out.glb").json)
    assert EXTENSION not in text and report.parts == 1 and "POSITION" in glb.primitive()["attributes"]
    given, idle = Glb(path).json, lambda root: {k: len(root.get(k, [])) - len(v) for k, v in used_in(root).items()}
    assert idle(glb.json) == idle(given) and len(glb.json["images"]) == 1 + len(
        options
    )  # views that the file never used
    for key in ("vertices", "origin"):
        a, b = (getattr(at.load(p).triangles(), key) for p in (path, tmp_path / "out.glb"))
        np.testing.assert_array_equal(a, b)
    position = glb.json["accessors"][glb.primitive()["attributes"]["POSITION"]]
    assert position["min"] == glb.attribute("POSITION").min(0).tolist()
    if not options:
        np.testing.assert_array_equal(at.load(path).appearance.uv, at.load(tmp_path / "out.glb").appearance.uv)


def test_draco_beside_plain_numbers_is_dropped(tmp_path):
    """A file with both has its plain numbers baked: the order of vertices may differ in the compressed data."""
    made = Gltf()
    points, faces = grid([0, 1, 2], [0, 1, 2])
    packed = DracoPy.encode(points, faces, 0, 7)
    both = primitive(made, points, faces)
    both["extensions"] = {EXTENSION: {"bufferView": made.view(packed), "attributes": {"POSITION": 0}}, "X_own": {}}
    made.node(mesh=made.mesh(both))
    made.json["extensionsUsed"] = [EXTENSION, "X_own"]
    at.bake(made.write(tmp_path), tmp_path / "out.glb", spp=4)
    glb = Glb(tmp_path / "out.glb")
    assert glb.primitive()["extensions"] == {"X_own": {}} and glb.json["extensionsUsed"] == ["X_own"]
    np.testing.assert_array_equal(glb.attribute("POSITION"), points)
    assert len(glb.json["bufferViews"]) == 3
