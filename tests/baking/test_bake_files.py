"""What a bake keeps of a file, and what it changes."""

import json

import numpy as np
import pytest

import antumbra as at
from antumbra.formats.format_registry import FORMATS
from antumbra.formats.gltf.gltf_asset import open_asset
from baked_files import Glb, box, grid, primitive, scene_file
from formats.test_format_registry import sample
from gltf_files import Gltf, png


@pytest.fixture
def rich(tmp_path):
    """A file with instances, an animation, a camera, a texture, extras and an unknown extension."""
    made = Gltf()
    shared = made.mesh(primitive(made, *box((-0.5, 0, -0.5), (0.5, 1, 0.5))), name="block", extras={"mine": [1, 2]})
    made.node(mesh=shared, name="a")
    moving = made.node(mesh=shared, name="b", translation=[1.05, 0.0, 0.0], scale=[1.0, 3.0, 3.0])
    made.animate(moving, "translation", [0.0, 1.0], [[1.05, 0.0, 0.0], [5.0, 0.0, 0.0]])
    made.node(camera=made.add("cameras", type="perspective", perspective={"yfov": 1.0, "znear": 0.1}))
    picture = made.add("images", bufferView=made.view(png(np.full((2, 2, 3), 200))), mimeType="image/png")
    made.add("textures", source=picture)
    look = {"baseColorTexture": {"index": 0}, "metallicFactor": 0.0}
    painted = made.add("materials", pbrMetallicRoughness=look, extensions={"X_own": {}})
    made.json["extensionsUsed"] = ["X_own"]
    floor = primitive(made, *grid([-3, 3], [-3, 3]), TEXCOORD_0=np.array([[0, 0], [0, 1], [1, 0], [1, 1]], np.float32))
    made.node(mesh=made.mesh({**floor, "material": painted}))
    return made.write(tmp_path, "rich.glb")


def test_what_is_not_baked_stays_byte_for_byte(rich, tmp_path):
    at.bake(rich, tmp_path / "out.glb", spp=16)
    before, after = Glb(rich), Glb(tmp_path / "out.glb")
    assert after.binary.startswith(before.binary.rstrip(b"\0")) and len(after.binary) > len(before.binary)
    for key in ("asset", "scenes", "scene", "cameras", "animations"):
        assert json.dumps(before.json[key]) == json.dumps(after.json[key])
    for key in ("accessors", "bufferViews", "images", "textures"):
        assert after.json[key][: len(before.json[key])] == before.json[key]


@pytest.mark.parametrize("options", [{}, {"texture": 32}, {"what": "light", "texture": 32}])
def test_what_is_not_baked_has_the_same_contents(rich, tmp_path, options):
    at.bake(rich, tmp_path / "out.glb", spp=16, **options)
    before, after = Glb(rich), Glb(tmp_path / "out.glb")
    for key in ("asset", "scenes", "scene", "cameras"):
        assert before.json[key] == after.json[key]
    assert after.json["extensionsUsed"][0] == "X_own" and "X_own" in json.dumps(after.json["materials"])
    assert [{k: v for k, v in n.items() if k != "mesh"} for n in after.json["nodes"]] == [
        {k: v for k, v in n.items() if k != "mesh"} for n in before.json["nodes"]
    ]
    assert after.json["meshes"][0]["extras"] == {"mine": [1, 2]}
    one, other = (glb.json["animations"][0]["samplers"][0] for glb in (before, after))
    for end in ("input", "output"):
        np.testing.assert_array_equal(before.array(one[end]), after.array(other[end]))
    np.testing.assert_array_equal(at.load(tmp_path / "out.glb").bounds, at.load(rich).bounds)
    assert at.load(tmp_path / "out.glb").n_triangles == at.load(rich).n_triangles


def test_a_mesh_of_several_nodes_is_divided_and_shares_its_accessors(rich, tmp_path):
    at.bake(rich, tmp_path / "out.glb", spp=64, attribute="_AO")
    glb = Glb(tmp_path / "out.glb")
    a, b = glb.primitive(0), glb.primitive(1)
    assert glb.json["nodes"][0]["mesh"] != glb.json["nodes"][1]["mesh"]
    assert a["attributes"]["POSITION"] == b["attributes"]["POSITION"] and a["indices"] == b["indices"]
    one, other = glb.attribute("_AO", 0), glb.attribute("_AO", 1)
    assert np.abs(one - other).max() > 0.1  # each is dark on the side of the other


def test_time_moves_what_is_baked(rich, tmp_path):
    at.bake(rich, tmp_path / "near.glb", spp=64, attribute="_AO")
    at.bake(rich, tmp_path / "far.glb", spp=64, attribute="_AO", time=1.0)
    near, far = (Glb(tmp_path / f"{n}.glb").attribute("_AO", 0) for n in ("near", "far"))
    assert far.mean() > near.mean() and (far - near).max() > 0.05


def test_materials_are_copied_where_others_use_them(tmp_path):
    made = Gltf()
    material = made.add("materials", name="shared")
    floor = primitive(made, *grid([0, 1], [0, 1]))
    lines = {"attributes": floor["attributes"], "mode": 1, "material": material}
    made.node(mesh=made.mesh({**floor, "material": material}, lines))
    at.bake(made.write(tmp_path), tmp_path / "out.glb", texture=16, spp=4)
    glb = Glb(tmp_path / "out.glb")
    assert glb.json["materials"][0] == {"name": "shared"}
    baked, other = glb.primitive(0, 0), glb.primitive(0, 1)
    assert other["material"] == 0 and glb.json["materials"][baked["material"]]["occlusionTexture"]["texCoord"] == 0


def test_colours_are_replaced_or_multiplied(tmp_path):
    colours = np.array([[0.5, 1.0, 0.25, 0.5]] * 4, np.float32)
    path = scene_file(tmp_path, grid([0, 1], [0, 1]), COLOR_0=colours)
    at.bake(path, tmp_path / "new.glb", spp=4)
    at.bake(path, tmp_path / "times.glb", spp=4, multiply=True)
    np.testing.assert_allclose(Glb(tmp_path / "new.glb").attribute("COLOR_0"), [[1, 1, 1, 0.5]] * 4, atol=1e-4)
    np.testing.assert_allclose(Glb(tmp_path / "times.glb").attribute("COLOR_0"), colours, atol=1e-4)


def test_copies_by_an_extension_become_nodes(tmp_path):
    made = Gltf()
    mesh = made.mesh(primitive(made, *box((-0.5, 0, -0.5), (0.5, 1, 0.5))))
    places = made.accessor(np.array([[0, 0, 0], [1.1, 0, 0], [9, 0, 0]], np.float32))
    made.node(mesh=mesh, extensions={"EXT_mesh_gpu_instancing": {"attributes": {"TRANSLATION": places}}})
    made.json["extensionsUsed"] = ["EXT_mesh_gpu_instancing"]
    path = made.write(tmp_path)
    report = at.bake(path, tmp_path / "out.glb", spp=64, attribute="_AO")
    glb = Glb(tmp_path / "out.glb")
    assert report.parts == 3 and len(glb.json["nodes"]) == 4 and "extensionsUsed" not in glb.json
    means = [glb.attribute("_AO", k).mean() for k in glb.json["nodes"][0]["children"]]
    assert means[0] < means[2] and abs(means[0] - means[1]) < 0.02
    np.testing.assert_array_equal(at.load(tmp_path / "out.glb").bounds, at.load(path).bounds)


def test_buffers_and_pictures_beside_a_gltf_are_taken_in(tmp_path):
    made = Gltf()
    floor = primitive(made, *grid([0, 1], [0, 1]))
    made.add("images", uri="paint.png")
    made.add("textures", source=0)
    made.node(mesh=made.mesh({**floor, "material": made.add("materials", pbrMetallicRoughness={})}))
    (tmp_path / "paint.png").write_bytes(png(np.zeros((1, 1, 3))))
    (tmp_path / "data.bin").write_bytes(made.data)
    (tmp_path / "made.gltf").write_bytes(made.gltf("data.bin"))
    at.bake(tmp_path / "made.gltf", tmp_path / "out.glb", spp=4)
    glb = Glb(tmp_path / "out.glb")
    assert "uri" not in glb.json["buffers"][0] and glb.image().shape == (1, 1, 3)
    assert glb.json["buffers"][0]["byteLength"] <= len(glb.binary)


def test_other_scenes_become_gltf_files(tmp_path):
    scene = at.procedural("atrium", triangles=2000)
    report = at.bake(scene, tmp_path / "atrium.glb", spp=4, multiply=True)
    made = at.load(tmp_path / "atrium.glb")
    assert made.n_triangles == scene.n_triangles and report.receivers > 500
    np.testing.assert_allclose(made.bounds, scene.bounds, atol=1e-4)
    (tmp_path / "flat.obj").write_text("v 0 0 5\nv 1 0 5\nv 0 1 5\nf 1 2 3\n")
    at.bake(tmp_path / "flat.obj", tmp_path / "flat.glb", spp=4, up="z", attribute="_AO")
    turned = at.load(tmp_path / "flat.glb")
    np.testing.assert_allclose(turned.bounds, [[0, 5, -1], [1, 5, 0]], atol=1e-6)  # +Z became +Y
    flat = Glb(tmp_path / "flat.glb")
    assert (flat.attribute("_AO", node=flat.json["nodes"][0]["children"][0]) == 1.0).all()


@pytest.mark.parametrize("suffix", ["", *(suffix for each in FORMATS for suffix in each.suffixes)])
def test_what_is_loaded_is_baked(suffix, tmp_path):
    path = sample(suffix, tmp_path)
    at.bake(path, tmp_path / "out.glb", attribute="_AO", spp=1)
    assert at.load(tmp_path / "out.glb").n_triangles == at.load(path).n_triangles > 0


def test_many_colours_become_vertex_colours(tmp_path):
    points, faces = grid(np.arange(20.0), np.arange(20.0))
    colours = np.random.default_rng(1).random((len(faces), 3))
    scene = at.Scene.from_arrays(points, faces, colours)
    at.bake(scene, tmp_path / "out.glb", spp=4, multiply=True)
    made = at.load(tmp_path / "out.glb")
    np.testing.assert_allclose(made.colours, colours, atol=1e-4)


def test_an_asset_that_is_not_edited_is_the_same(rich, tmp_path):
    (tmp_path / "same.glb").write_bytes(open_asset(rich).glb())
    before, after = Glb(rich), Glb(tmp_path / "same.glb")
    assert before.json == after.json and after.binary.startswith(
        before.binary[: before.json["buffers"][0]["byteLength"]]
    )


@pytest.mark.parametrize(
    "options, words",
    [
        ({"what": "gold"}, "gold"),
        ({"what": "sun", "radius": 1.0}, "radius"),
        ({"lights": at.PointLight((0, 1, 0))}, "sky"),
        ({"what": "sun", "lights": at.PointLight((0, 1, 0))}, "DirectionalLight"),
        ({"uv": 0}, "texture"),
        ({"texture": 8}, "texture"),
        ({"texture": 64, "attribute": "_AO"}, "attribute"),
        ({"texture": 64, "bit_depth": 12}, "bit_depth"),
        ({"attribute": "AO"}, "_AO"),
        ({"attribute": "_AO", "multiply": True}, "multiply"),
        ({"what": "sun", "texture": 64, "denoise": True}, "denoise"),
        ({"what": "ao", "texture": 64, "unlit": True}, "unlit"),
        ({"what": "light", "unlit": True}, "unlit"),
        ({"png": True}, "png"),
        ({"bounces": 1}, "bounces"),
        ({"spp": 0}, "spp"),
        ({"exposure": -1}, "exposure"),
        ({"plan": "gold"}, "gold"),
        ({"texture": 64, "uv": 0}, "TEXCOORD_0"),
    ],
)
def test_bad_arguments_are_named(tmp_path, options, words):
    path = scene_file(tmp_path, grid([0, 1], [0, 1]))
    with pytest.raises(at.InputError, match=words):
        at.bake(path, tmp_path / "out.glb", **options)
    assert not (tmp_path / "out.glb").exists()
