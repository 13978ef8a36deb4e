"""Textures, colours of vertices, normals and alpha of scenes, as the loaders read them."""

import numpy as np
import pytest

import antumbra as at
from antumbra.scene.appearance import normals_in_frames
from antumbra.scene.materials import BLEND, CLAMP, MASK, MIRROR, OPAQUE, REPEAT, Texture, texture_means
from gltf_files import TETRAHEDRON, TETRAHEDRON_FACES, Gltf, png
from scenes import scene_path

UV = np.array([[0.1, 0.2], [0.4, 0.2], [0.1, 0.4]], np.float32)
LAMBERTIAN = {"metallicFactor": 0, "roughnessFactor": 1}
FOUR = np.array([[[255, 0, 0], [0, 255, 0]], [[0, 0, 255], [255, 255, 255]]], np.uint8)


def in_plane(corners, kept):
    """Normals again from what `in_frames` keeps, by least squares: the inverse of its definition."""
    e1, e2 = corners[1] - corners[0], corners[2] - corners[0]
    across = np.cross(e1, e2)
    rows = np.stack([e1, e2, across / np.sqrt(np.linalg.norm(across))])
    found = np.linalg.solve(rows, np.asarray(kept, np.float64).T).T
    return found / np.linalg.norm(found, axis=1, keepdims=True)


def with_texture(image=FOUR, uv=UV, sampler=None, info=(), material=(), uv_set="TEXCOORD_0"):
    made = Gltf()
    picture = made.add("images", bufferView=made.view(png(image)), mimeType="image/png")
    samplers = {} if sampler is None else {"sampler": made.add("samplers", **sampler)}
    texture = {"index": made.add("textures", source=picture, **samplers), **dict(info)}
    look = made.add("materials", pbrMetallicRoughness={"baseColorTexture": texture}, **dict(material))
    made.node(mesh=made.mesh(made.primitive(attributes={uv_set: made.accessor(uv)}, material=look)))
    return made


def loaded(made, folder):
    return at.load(made.write(folder))


def test_plain_scenes_have_no_appearance(tmp_path):
    made = Gltf()
    made.node(mesh=made.mesh(made.primitive(material=made.add("materials", pbrMetallicRoughness=LAMBERTIAN))))
    assert loaded(made, tmp_path).appearance is None
    assert at.procedural("atrium", triangles=5000).appearance is None


def test_coordinates_are_of_corners_and_count_from_the_upper_left(tmp_path):
    scene = loaded(with_texture(), tmp_path)
    shown = scene.appearance
    np.testing.assert_array_equal(shown.uv, UV[None])
    np.testing.assert_array_equal(shown.textures[0].pixels[..., :3], FOUR)
    np.testing.assert_allclose(scene.colours, [[1, 0, 0]], atol=1e-6)  # all of the face shows the first texel
    assert shown.textured.all() and shown.materials[shown.material_of_face[0]].alpha_mode == OPAQUE
    assert shown.normals is None and shown.colours is None


def test_samplers_and_alpha(tmp_path):
    sampler = {"wrapS": 33071, "wrapT": 33648, "magFilter": 9728}
    scene = loaded(with_texture(sampler=sampler, material={"alphaMode": "MASK", "alphaCutoff": 0.25}), tmp_path)
    (material,) = scene.appearance.materials
    assert (material.alpha_mode, material.cutoff, material.double_sided) == (MASK, 0.25, False)
    texture = material.texture
    assert (texture.wrap_s, texture.wrap_t, texture.nearest, texture.has_alpha) == (CLAMP, MIRROR, True, True)


def test_transforms_and_other_sets(tmp_path):
    transform = {"offset": [0.5, 0.25], "rotation": np.pi / 2, "scale": [1.0, 0.5], "texCoord": 1}
    made = with_texture(info={"extensions": {"KHR_texture_transform": transform}}.items(), uv_set="TEXCOORD_1")
    # counter-clockwise by a quarter, as v points down: (u, v) -> (v, -u)
    expected = np.stack([0.5 * UV[:, 1] + 0.5, -UV[:, 0] + 0.25], 1)
    np.testing.assert_allclose(loaded(made, tmp_path).appearance.uv[0], expected, atol=1e-6)


def test_an_alpha_below_one_is_an_appearance_too(tmp_path):
    made = Gltf()
    glass = made.add("materials", pbrMetallicRoughness={"baseColorFactor": [1, 1, 1, 0.25]}, alphaMode="BLEND")
    made.node(mesh=made.mesh(made.primitive(material=glass)))
    (material,) = loaded(made, tmp_path).appearance.materials
    assert material.alpha_mode == BLEND and material.factor[3] == 0.25


def test_colours_of_vertices_reach_the_corners(tmp_path):
    colours = np.random.default_rng(2).uniform(0, 1, (4, 4)).astype(np.float32)
    made = Gltf()
    attributes = {"COLOR_0": made.accessor(colours)}
    made.node(mesh=made.mesh(made.primitive(TETRAHEDRON, TETRAHEDRON_FACES, attributes=attributes)))
    np.testing.assert_array_equal(loaded(made, tmp_path).appearance.colours, colours[TETRAHEDRON_FACES])
    scene = at.Scene.from_arrays(TETRAHEDRON, TETRAHEDRON_FACES, vertex_colours=colours[:, :3])
    np.testing.assert_array_equal(scene.appearance.colours[..., :3], colours[TETRAHEDRON_FACES][..., :3])


@pytest.mark.parametrize(
    "placed",
    [
        {"rotation": [0.5, -0.5, 0.5, 0.5], "translation": [3, 4, 5]},
        {"rotation": [0.0, 0.6, 0.0, 0.8], "scale": [2.0, 0.3, 5.0]},
        {"rotation": [0.0, 0.6, 0.0, 0.8], "scale": [-1.0, 0.3, 5.0]},
    ],
)
def test_normals_are_those_of_the_inverse_transpose(tmp_path, placed):
    rng = np.random.default_rng(5)
    normals = rng.normal(size=(4, 3)).astype(np.float32)
    made = Gltf()
    attributes = {"NORMAL": made.accessor(normals)}
    mesh = made.mesh(made.primitive(TETRAHEDRON, TETRAHEDRON_FACES, attributes=attributes))
    made.node(mesh=mesh)
    made.node(mesh=mesh, **placed)
    scene = loaded(made, tmp_path)
    corners, kept = scene.triangles().vertices.astype(np.float64), scene.appearance.normals
    local = TETRAHEDRON.astype(np.float64)
    found = {v: corners[4 + f, c] for f, face in enumerate(TETRAHEDRON_FACES) for c, v in enumerate(face)}
    world = np.array([found[v] for v in range(4)])
    linear = np.linalg.solve((local - local[0])[1:], (world - world[0])[1:]).T  # of the node, from its own corners
    expected = normals @ np.linalg.inv(linear)
    expected /= np.linalg.norm(expected, axis=1, keepdims=True)
    for f, face in enumerate(TETRAHEDRON_FACES):
        np.testing.assert_allclose(in_plane(corners[4 + f], kept[4 + f]), expected[face], atol=1e-4)


def test_kept_normals_move_with_their_triangle():
    rng = np.random.default_rng(6)
    corners, normals = rng.normal(size=(50, 3, 3)), rng.normal(size=(50, 3, 3))
    turn, _ = np.linalg.qr(rng.normal(size=(3, 3)))
    turn *= np.sign(np.linalg.det(turn))
    kept = normals_in_frames(corners, normals)
    np.testing.assert_allclose(normals_in_frames(corners @ turn.T + 7.0, normals @ turn.T), kept, atol=1e-5)
    for before, each in zip(corners, zip(kept, normals)):
        expected = each[1] / np.linalg.norm(each[1], axis=1, keepdims=True)
        np.testing.assert_allclose(in_plane(2.5 * before @ turn.T, each[0]), expected @ turn.T, atol=1e-3)


def test_one_line_says_what_was_left_out(tmp_path):
    made = with_texture(material={"normalTexture": {"index": 0}, "emissiveFactor": [1, 0, 0]})
    made.json["materials"][0]["pbrMetallicRoughness"]["metallicFactor"] = 0.5
    extensions = "transmission", "volume", "clearcoat", "emissive_strength"
    made.json["materials"][0]["extensions"] = {f"KHR_materials_{name}": {} for name in extensions}
    with pytest.warns(UserWarning, match="left out") as caught:
        loaded(made, tmp_path)
    (said,) = (str(each.message) for each in caught)
    assert said == "made.glb: left out: clearcoat, refraction and volumes"


def test_obj_has_coordinates_normals_and_holes(tmp_path):
    (tmp_path / "c.png").write_bytes(png(FOUR))
    (tmp_path / "a.png").write_bytes(png(np.full((4, 4, 3), [[[0]], [[255]], [[0]], [[255]]], np.uint8)))
    (tmp_path / "m.mtl").write_text(
        "newmtl leaf\nKd 1 1 1\nmap_Kd -s 1 1 1 c.png\nmap_d a.png\nnewmtl glass\nd 0.25\nKd 0 1 0\n"
    )
    text = "mtllib m.mtl\nv 0 0 0\nv 1 0 0\nv 0 1 0\nvt 0.1 0.8\nvt 0.4 0.8\nvt 0.1 0.6\nvn 0 0 1\nvn 0 1 0\n"
    (tmp_path / "a.obj").write_text(text + "usemtl leaf\nf 1/1/1 2/2/1 3/3/2\nusemtl glass\nf 1/1/1 3/2/1 2/3/2\n")
    scene = at.load(tmp_path / "a.obj")
    materials = {m.name: m for m in scene.appearance.materials}
    leaf, glass = materials["leaf"], materials["glass"]
    assert (leaf.alpha_mode, glass.alpha_mode, glass.factor) == (MASK, BLEND, (0.0, 1.0, 0.0, 0.25))
    assert leaf.texture.pixels.shape == (4, 4, 4) and (leaf.texture.pixels[0, :, 3] == 0).all()
    own = scene.appearance.material_of_face == scene.appearance.materials.index(leaf)
    np.testing.assert_allclose(
        np.sort(scene.appearance.uv[own][0], 0), np.sort([[0.1, 0.2], [0.4, 0.2], [0.1, 0.4]], 0)
    )
    assert scene.appearance.normals is not None and not scene.notes


@pytest.mark.parametrize("wrap, shown", [(REPEAT, [1, 1, 1]), (CLAMP, [1, 0, 0]), (MIRROR, [1, 0, 1])])
def test_means_of_faces_beyond_the_edges(wrap, shown):
    pixels = np.zeros((1, 4, 4), np.uint8)
    pixels[0, 1, 0] = 255  # from 0.25 to 0.5
    u = np.array([0.35, 1.35, -1.65])[:, None]
    uv = np.stack([u + [0.0, 1e-3, 0.0], 0.5 + 0.0 * u + [0.0, 0.0, 1e-3]], -1)
    np.testing.assert_array_equal(texture_means(Texture("t", pixels, wrap_s=wrap), uv)[:, 0], shown)


def test_real_models_have_their_textures_and_normals():
    man = at.load(scene_path("gltf/CesiumMan.glb")).appearance
    assert man.textured.all() and man.normals.any() and man.textures[0].pixels.shape[2] == 4
    with pytest.warns(UserWarning, match="animations"):
        fox = at.load(scene_path("gltf/Fox.glb")).appearance
    assert fox.textured.all() and fox.normals is None


def test_unknown_alpha_modes_are_refused(tmp_path):
    made = with_texture(material={"alphaMode": "glass"})
    with pytest.raises(at.InputError, match="alphaMode is 'glass'; it must be OPAQUE, MASK or BLEND"):
        loaded(made, tmp_path)
